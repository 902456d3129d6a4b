# SPDX-License-Identifier: Apache-2.0
"""What moves a joint, as numbers of its drive: read from the model's fields with parameter values written into them."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from trueup.arrays import Array, Integers
from trueup.articulated.assignments import Assignment, needs, write
from trueup.articulated.laws import STRIBECK_SPEED
from trueup.articulated.lone_joint import Command, Drives
from trueup.articulated.signals import Signals
from trueup.engines.mujoco.attributes import MujocoAttributes
from trueup.engines.mujoco.gears import SECOND
from trueup.engines.mujoco.run import Parametrised
from trueup.rounding import TINY

_LIVE = ("dead_band", "punch", "friction_static", "stribeck_speed", "friction_load")
"""Kinds that act in every step."""


def alone(compiled: mujoco.MjModel, quantities: Sequence[Assignment]) -> bool:
    """Whether every joint of a model is a hinge or a slide in no loop, with at most one drive, which has no memory, and
    neither backlash nor a spring that is calibrated.
    """
    if compiled.nq != compiled.nv or compiled.na or _closed(compiled) or _beyond(quantities):
        return False
    affine = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))
    simple = (compiled.actuator_gaintype == int(mujoco.mjtGain.mjGAIN_FIXED)) & np.isin(
        compiled.actuator_biastype, affine
    )
    at_joint = compiled.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)
    driven = compiled.actuator_trnid[:, 0]
    return compiled.nu > 0 and bool(np.all(simple & at_joint)) and len(np.unique(driven)) == len(driven)


def _closed(compiled: mujoco.MjModel) -> bool:
    """Whether links are joined into loops, through which joints carry one another; fingers that follow one another do not."""
    return bool(np.any(compiled.eq_type != int(mujoco.mjtEq.mjEQ_JOINT)))


def _beyond(quantities: Sequence[Assignment]) -> bool:
    """Whether parameters set what a joint alone does not have."""
    springs = any(a.startswith("joint.spring") for q in quantities for a in q.quantity.attributes)
    return springs or any(needs(quantities, kind) for kind in SECOND)


class _Fields:
    """(b, ...) fields of a model by name, made where they are first asked for (see `fields.Fields`)."""

    def __init__(self, compiled: mujoco.MjModel, rows: int) -> None:
        self._compiled, self._rows = compiled, rows
        self._made: dict[str, Array] = {}

    def expand(self, name: str) -> Array:
        """The live array of a field."""
        if name not in self._made:
            owner = self._compiled.opt if name.startswith("opt.") else self._compiled
            value = np.asarray(getattr(owner, name.removeprefix("opt.")))
            self._made[name] = np.repeat(value[None], self._rows, axis=0)
        return self._made[name]


class Driven:
    """The drives of all joints in one trial, for b rows of values (b, n).

    `loads` (b,) says which load each row has, `rigid` (g, nv, nv) the inertia matrix of each load in the reference pose.
    """

    def __init__(
        self, whole: Parametrised, signals: Signals, trial: int, values: Array, loads: Integers,
        rigid: Array, step: float, beside: Driven | None = None,
    ) -> None:  # fmt: skip
        """`beside`: drives of the same rows in another trial, which are the same where neither has gains of its own."""
        self._compiled, self._signals, self._trial, self._loads = whole.compiled, signals, trial, loads
        self._step, self.rows = step, len(values)
        self._start = signals.start(trial)
        self.usual = not whole.gains.scales([signals.trial(trial).name])
        if beside is not None and beside.usual and self.usual:
            self._fields, self._live, self._weight = beside._fields, beside._live, beside._weight
            return
        self._fields = _Fields(whole.compiled, len(values))
        copies = MujocoAttributes(whole.compiled, self._fields)
        write(whole.quantities, values, copies)
        whole.gains.scale(whole.model, copies, [signals.trial(trial).name], len(values))
        self._live = [(q.kind, q.targets, values[:, c]) for c, q in enumerate(whole.quantities) if q.kind in _LIVE]
        armature = self._fields.expand("dof_armature")
        inverse = np.linalg.inv(rigid[loads] + armature[:, None] * np.eye(whole.compiled.nv))
        self._weight = np.diagonal(inverse, axis1=1, axis2=2)

    def alike(self, joint: int) -> tuple[Drives, Integers]:
        """The drives of one joint that differ, (u,) each, and (b,) which of them each row has."""
        columns = {**self._passive(joint), **self._drive(joint), **self._signal(joint)}
        rows = np.stack([np.broadcast_to(columns[name], len(self._loads)) for name in Drives._fields[:-1]], axis=1)
        every, again = np.unique(np.hstack([rows, self._loads[:, None]]), axis=0, return_inverse=True)
        parts = [np.ascontiguousarray(part) for part in every[:, :-1].T]
        return Drives(*parts, load=every[:, -1].astype(np.int64)), again.reshape(-1)

    def command(self, joint: int) -> Command:
        """What a joint's drive is told."""
        return Command(*self._signals.held(self._trial, self._name("actuator", self._actuator(joint))))

    def _actuator(self, joint: int) -> int:
        driven = np.flatnonzero(self._compiled.actuator_trnid[:, 0] == joint)
        return int(driven[0]) if len(driven) else -1

    def _passive(self, joint: int) -> dict[str, Array]:
        """Friction, inertia and start of a joint."""
        field = self._fields.expand
        impedance, reference = field("dof_solimp")[:, joint], field("dof_solref")[:, joint]
        held = np.clip(impedance[:, 0], 1e-4, 0.9999)
        settles = np.maximum(reference[:, 0], 2.0 * self._step)
        direct = -reference[:, 1] / impedance[:, 1]
        return {
            "damping": field("dof_damping")[:, joint],
            "damping_linear": field("dof_dampingpoly")[:, joint, 0],
            "damping_square": field("dof_dampingpoly")[:, joint, 1],
            "armature": field("dof_armature")[:, joint],
            "friction": field("dof_frictionloss")[:, joint],
            "softness": (1.0 - held) / held * self._weight[:, joint],
            "creep_rate": np.where(reference[:, 0] > 0.0, 2.0 / (impedance[:, 1] * settles), direct),
            "position": self._start[0][:, joint],
            "speed": self._start[1][:, joint],
            "static": self._living("friction_static", joint, 0.0),
            "stribeck_speed": self._living("stribeck_speed", joint, STRIBECK_SPEED),
            "friction_load": self._living("friction_load", joint, 0.0),
        }

    def _drive(self, joint: int) -> dict[str, Array]:
        """Force of the actuator of a joint, and limits of its control and of the joint's torque; none where it has none."""
        m, field, i = self._compiled, self._fields.expand, self._actuator(joint)
        driven = i >= 0
        affine = driven and int(m.actuator_biastype[i]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
        constant, by_length, by_speed = (float(affine) * field("actuator_biasprm")[:, i, k] for k in range(3))
        bounds = {
            "force": ("actuator_forcerange", i, driven and m.actuator_forcelimited[i]),
            "control": ("actuator_ctrlrange", i, driven and m.actuator_ctrllimited[i]),
            "torque": ("jnt_actfrcrange", joint, m.jnt_actfrclimited[joint]),
        }
        return {
            "gain": float(driven) * field("actuator_gainprm")[:, i, 0], "gear": field("actuator_gear")[:, i, 0],
            "constant": constant, "by_length": by_length, "by_speed": by_speed,
            **{f"{name}_low": _limit(field(f)[:, at, 0], limited, -np.inf) for name, (f, at, limited) in bounds.items()},
            **{f"{name}_high": _limit(field(f)[:, at, 1], limited, np.inf) for name, (f, at, limited) in bounds.items()},
        }  # fmt: skip

    def _signal(self, joint: int) -> dict[str, Array]:
        """What becomes of the command before it reaches the actuator of a joint."""
        i = self._actuator(joint)
        shaped = self._signals.shaping(self._trial, self._name("actuator", i))
        if i < 0:
            return {"dead_band": np.zeros(len(self._loads)), "kick": np.zeros(len(self._loads)), **shaped}
        band, punch = (self._living(kind, self._name("actuator", i), 0.0) for kind in ("dead_band", "punch"))
        stiffness = np.maximum(self._fields.expand("actuator_gainprm")[:, i, 0], TINY)
        # A dead band is given end to end.
        return {"dead_band": 0.5 * band, "kick": np.where(punch > 0.0, punch / stiffness, 0.0), **shaped}

    def _living(self, kind: str, target: int | str, otherwise: float) -> Array:
        """(b,) value of a kind that acts in every step, at one target."""
        name = self._name("joint", target) if isinstance(target, int) else target
        found = np.full(len(self._loads), otherwise)
        for other, targets, value in self._live:
            if other == kind and name in targets:
                found = value
        return found

    def _name(self, what: str, number: int) -> str:
        return str(getattr(self._compiled, what)(number).name) if number >= 0 else ""


def _limit(bound: Array, limited: bool, otherwise: float) -> Array:
    return bound if limited else np.full(len(bound), otherwise)
