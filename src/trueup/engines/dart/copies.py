# SPDX-License-Identifier: Apache-2.0
"""Copies of a robot stepped by DART, each in a world of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import dartpy
import mujoco
import numpy as np

from trueup.arrays import Array, Integers
from trueup.articulated.described import StoredCopies
from trueup.articulated.model import WORLD, BasePose, Engine
from trueup.articulated.pose import POSITION, angles_of, quaternion_of, quaternions_of_vectors, turning
from trueup.articulated.starts import at_rest
from trueup.engines.dart.hulls import hulls
from trueup.engines.dart.sensors import Sensors
from trueup.engines.dart.skeleton import lay_floor, new_world, plane_name, shapes_of, transform
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.wiring import rest
from trueup.rounding import first_step

LONGEST = 5e-4
"""s: DART applies the servos' forces explicitly; with steps of 2 ms a standing humanoid falls over, with these it stands."""

_SERVO = ("actuator.kp", "actuator.kv", "actuator.zero", "actuator.gain", "actuator.force_limit")


class DartCopies(StoredCopies):
    """Attributes are kept as arrays, and written into the worlds when these are first stepped and whenever they change."""

    model: Engine

    def __init__(self, model: Engine, file: Model, rows: int) -> None:
        super().__init__(model, rows)
        self._file, self._compiled, self._floating = file, file.compiled, POSITION in model.channels()
        shapes = hulls(self._compiled)
        self.worlds = [new_world(self._compiled, shapes) for _ in range(rows)]
        self.robots = [w.getSkeleton("robot") for w in self.worlds]
        self._force_on, self._advance = [r.setForces for r in self.robots], [w.step for w in self.worlds]
        self._placed, self._moving = [r.getPositions for r in self.robots], [r.getVelocities for r in self.robots]
        order = [self.robots[0].getJoint(j).getIndexInSkeleton(0) for j in self._joints]
        self._dofs = _slice(order)
        self._zeros = np.array([
            self._compiled.qpos0[self._compiled.jnt_qposadr[self._compiled.joint(j).id]] for j in self._joints
        ])  # fmt: skip
        self.base_position, self.base_orientation, self.base_turning, self._rotations = np.zeros((4, rows, 3))
        self._sensors = Sensors(self._compiled, self._joints, self.robots)
        self._seen: Array | None = None
        # Lost: some number is none, where DART goes on with zeros.
        self._stopped, self._lost = np.zeros((2, rows), dtype=bool)
        self._driven = [(i, a) for i, a in enumerate(model.drives().values()) if a]
        self._at = _slice([i for i, _ in self._driven])
        self._columns = [model.columns()[a] for _, a in self._driven]
        self._range = _command_range(self._compiled, self._columns)
        self._whole = np.zeros((rows, self.robots[0].getNumDofs()))
        self._pushes: dict[str, tuple[list[Any], Array, Array]] = {}
        self._drives: tuple[Array, ...] | None = None
        self.substep, self._set = LONGEST, 0.0
        self._damping, self._shared = np.zeros_like(self.position), 0.0
        for joint in self._joints:
            self._apply("joint.friction", joint)
        for name in model.names("body")[1:]:
            self._apply("body.mass", name)
        self._apply("world.gravity", WORLD)
        begun = rest(self._compiled)[0][:7]
        still = np.zeros(3)
        base = BasePose(begun[:3], still, angles_of(begun[3:]), still) if self._floating else None
        place, pace = (np.tile(x, (rows, 1)) for x in at_rest(model))
        self.place(place, pace, base)

    def set(self, attribute: str, name: str, values: Array) -> None:
        """See Writable."""
        if attribute == "body.mass":  # the body keeps its shape
            share = values / self.get(attribute, name)
            super().set("body.inertia", name, self.get("body.inertia", name) * share[:, None, None])
        bad = ~np.isfinite(values).reshape(len(values), -1).all(axis=1)
        self._lost |= bad
        super().set(
            attribute, name, np.where(bad.reshape(-1, *[1] * (values.ndim - 1)), self.get(attribute, name), values)
        )
        self._drives = None
        self._apply(attribute, name)

    def place(self, position: Array, velocity: Array, base: BasePose | None = None) -> None:
        """See Running."""
        for row, (robot, q, v) in enumerate(zip(self.robots, position - self._zeros, velocity, strict=True)):
            whole, speeds = robot.getPositions(), robot.getVelocities()
            whole[self._dofs], speeds[self._dofs] = q, v
            if base is not None and self._floating:
                parts = (base.position, base.velocity, base.angles, base.rates)
                place, pace, angles, rates = (x if x.ndim == 1 else x[row] for x in parts)
                there = transform(place, quaternion_of(angles))
                whole[:6] = dartpy.dynamics.FreeJoint.convertToPositions(there)
                # DART's velocity of a free joint is that of the body in its own axes, turning first.
                speeds[:3] = turning(angles, rates)
                speeds[3:6] = there.rotation().T @ pace
            robot.setPositions(whole)
            robot.setVelocities(speeds)
        self._gather(range(self.rows), speeds=True)

    def push(self, body: str, force: Array) -> None:
        """See Pushable."""
        self._pushes.pop(body, None)
        if force.any():
            nodes = [robot.getBodyNode(body) for robot in self.robots]
            self._pushes[body] = nodes, force, self.get("body.com", body)

    def reader(self, state: str, joints: Sequence[str]) -> Callable[[int], Array]:
        """See Copies."""
        if state not in self.model.channels():
            return super().reader(state, joints)
        where = [self.model.channels()[state].index(label) for label in joints]
        read = self._sensed if state in self._sensors.columns else lambda name: getattr(self, name)
        return lambda n: np.ascontiguousarray(read(state)[:n, where])

    def _sensed(self, name: str) -> Array:
        """(b, k) what a sensor of the file tells; all are computed once a state."""
        if self._seen is None:
            base = None
            if self._floating:
                turns = quaternions_of_vectors(self._rotations)
                speed = np.array([np.asarray(r.getRootBodyNode().getLinearVelocity()) for r in self.robots])
                base = {"qpos": np.hstack([self.base_position, turns]), "qvel": np.hstack([speed, self.base_turning])}
            gravity = self.get("world.gravity", WORLD)
            self._seen = self._sensors.read(self.position, self.velocity, self.force, gravity, base)
        return self._seen[:, self._sensors.columns[name]]

    def stop(self, rows: Integers) -> None:
        """These are stepped no further."""
        self._stopped[rows] = True

    def step(self, command: Array, step: float) -> None:
        """See Running."""
        count = first_step(step, LONGEST)
        self.substep = step / count
        if self.substep != self._set:
            self._set = self.substep
            for world in self.worlds:
                world.setTimeStep(self.substep)
        law = self._law(command)
        self._share_damping()
        damped = bool(np.any(law.kv) or np.any(self._damping))  # only then are speeds asked for between two commands
        going = np.flatnonzero(~(self._stopped | self._lost)).tolist()
        for k in range(count):
            forces = self._forces(law)
            if self._lost.any():
                going = [row for row in going if not self._lost[row]]
            for nodes, push, com in self._pushes.values():
                for row in going:
                    nodes[row].addExtForce(push[row], com[row], False, True)
            for row in going:
                self._force_on[row](forces[row])
                self._advance[row]()
            self._gather(going, speeds=damped, last=k + 1 == count)
        if self._lost.any():
            self.position[self._lost] = np.nan

    def _share_damping(self) -> None:
        """Viscous friction is applied here where a joint takes longer than a substep to slow down, as it does on average over
        one; elsewhere by DART, implicitly.

        DART counts its implicit friction in what forces do and not in what contacts do: a joint of a robot that lies on the
        ground would sag too far, by the share that substep x damping has of its inertia.
        """
        if self._shared == self.substep or not self._joints:
            return
        self._shared = self.substep
        damping = np.stack([self.get("joint.damping", j) for j in self._joints], axis=1)
        inertia = np.stack([
            self.get("joint.inertia", j) - self.model.get("joint.armature", j) + self.get("joint.armature", j)
            for j in self._joints
        ], axis=1)  # fmt: skip
        gone = self.substep * damping / inertia  # of the speed, at first
        own = gone <= 1.0
        self._damping = np.where(own, -np.expm1(-gone) * inertia / self.substep, 0.0)
        for robot, row in zip(self.robots, np.where(own, 0.0, damping), strict=True):
            for joint, value in zip(self._joints, row.tolist(), strict=True):
                robot.getJoint(joint).setDampingCoefficient(0, value)

    def _law(self, command: Array) -> ServoLaw:
        """What the drives do about positions and speeds during a step: position servos within their limits, or motors."""
        if self._drives is None:
            servo = np.array([self.get("actuator.servo", a)[0] for _, a in self._driven]) > 0.0
            motor = np.array([self.get("actuator.torque", a)[0] for _, a in self._driven])
            kp, kv, zero, gain, limit = (self._stacked(a) for a in _SERVO)
            limit = np.where(limit > 0.0, limit, np.inf)
            self._drives = gain * np.where(servo, kp, motor), gain * kp * zero, gain * kp, gain * kv, limit
        given, offset, kp, kv, limit = self._drives
        told = command[:, self._columns]
        if self._range is not None:
            told = np.minimum(np.maximum(told, self._range[0]), self._range[1])
        return ServoLaw(given * told + offset, kp, kv, limit)

    def _forces(self, law: ServoLaw) -> Array:
        """(b, dofs) in DART's order; the base is not driven."""
        position, velocity = self.position[:, self._at], self.velocity[:, self._at]
        wanted = law.given - law.kp * position - law.kv * velocity
        self.force[:, self._at] = np.minimum(np.maximum(wanted, -law.limit), law.limit)
        self._whole[:, self._dofs] = self.force - self._damping * self.velocity
        if not np.isfinite(self.force.sum()):
            self._lost |= ~np.isfinite(self.force).all(axis=1)
        return self._whole

    def _stacked(self, attribute: str) -> Array:
        """(b, k) of the driven joints; 0 where a motor has no such thing."""
        columns = []
        for _, actuator in self._driven:
            servo = self.get("actuator.servo", actuator)[0] > 0.0
            known = servo or attribute in ("actuator.gain", "actuator.force_limit")
            columns.append(self.get(attribute, actuator) if known else np.zeros(self.rows))
        return np.stack(columns, axis=1) if columns else np.zeros((self.rows, 0))

    def _apply(self, attribute: str, name: str) -> None:
        family = attribute.partition(".")[0]
        if attribute == "joint.damping":
            self._shared = 0.0
        elif attribute == "joint.friction":
            for robot, value in zip(self.robots, self.get(attribute, name), strict=True):
                robot.getJoint(name).setCoulombFriction(0, float(value))
        elif attribute == "joint.armature":
            self._shared = 0.0
            body = int(self._compiled.jnt_bodyid[self._compiled.joint(name).id])
            self._write_body(self._compiled.body(body).name)
        elif family == "body":
            self._write_body(name)
        elif attribute == "world.gravity":
            for world, value in zip(self.worlds, self.get(attribute, name), strict=True):
                world.setGravity(value)
        elif attribute in ("geom.friction", "world.floor_friction"):
            geom = name if family == "geom" else plane_name(self._compiled)
            for world, value in zip(self.worlds, self.get(attribute, name), strict=True):
                for shape in shapes_of(world, geom):
                    shape.getDynamicsAspect().setFrictionCoeff(float(value))
        elif attribute in ("world.floor_height", "world.floor_tilt"):
            heights, tilts = self.get("world.floor_height", WORLD), self.get("world.floor_tilt", WORLD)
            for world, height, tilt in zip(self.worlds, heights, tilts, strict=True):
                lay_floor(self._compiled, world, float(height), tilt)

    def _write_body(self, name: str) -> None:
        """Mass, centre of mass and inertia of a body; the rotor of its joint turns with it, about the joint's axis.

        DART knows no rotors. What the rotor adds is exact where the body before it rests, and counts the motion of that
        body too where it does not.
        """
        body = self._compiled.body(name)
        mass, com, inertia = (self.get(f"body.{x}", name) for x in ("mass", "com", "inertia"))
        rotor = np.zeros((3, 3))
        if body.jntnum[0] == 1 and self._compiled.jnt_type[body.jntadr[0]] == 3:
            joint, axis = self._compiled.joint(int(body.jntadr[0])).name, self._compiled.jnt_axis[int(body.jntadr[0])]
            rotor = np.outer(axis, axis) * self.get("joint.armature", joint)[:, None, None]
        for robot, m, c, i in zip(self.robots, mass, com, inertia + rotor, strict=True):
            robot.getBodyNode(name).setInertia(dartpy.dynamics.Inertia(float(m), c, i))

    def _gather(self, rows: Sequence[int], *, speeds: bool, last: bool = True) -> None:
        """Takes the state of some rows out of their worlds, that of their bases at `last`; what is no number is lost."""
        base, self._seen = last and self._floating, None
        if not len(rows):
            return
        some = slice(None) if len(rows) == self.rows else np.asarray(rows)
        placed = np.array([self._placed[row]() for row in rows])
        self.position[some] = placed[:, self._dofs] + self._zeros
        if speeds or last:
            moving = np.array([self._moving[row]() for row in rows])
            self.velocity[some] = moving[:, self._dofs]
            if base:  # DART has its rotation vector and its place first, its velocity in its own axes
                self.base_position[some] = placed[:, 3:6]
                self._rotations[some] = placed[:, :3]
                self.base_orientation[some] = angles_of(quaternions_of_vectors(placed[:, :3]))
                self.base_turning[some] = moving[:, :3]
        if not np.isfinite(self.position.sum() + self.velocity.sum()):
            self._lost |= ~np.isfinite(self.position + self.velocity).all(axis=1)


class ServoLaw(NamedTuple):
    """force = given - kp position - kv velocity within +- limit; (b, k) of the driven joints."""

    given: Array
    kp: Array
    kv: Array
    limit: Array


def _slice(order: Sequence[int]) -> slice | Integers:
    """Columns in this order, as a slice where they are neighbours: then nothing is copied."""
    if len(order) and list(order) == list(range(order[0], order[0] + len(order))):
        return slice(order[0], order[0] + len(order))
    return np.array(order, dtype=np.int64)


def _command_range(compiled: mujoco.MjModel, columns: Sequence[int]) -> tuple[Array, Array] | None:
    """(k,), (k,) within what commands are taken, None where no actuator of the columns has a range."""
    limited = compiled.actuator_ctrllimited[columns].astype(bool)
    low, high = compiled.actuator_ctrlrange[columns].T
    return (np.where(limited, low, -np.inf), np.where(limited, high, np.inf)) if limited.any() else None
