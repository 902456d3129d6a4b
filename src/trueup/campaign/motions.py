# SPDX-License-Identifier: Apache-2.0
"""A transition of one's own humanoid, from a model file whose keyframes name where it starts and where it shall end."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trueup.arrays import Array
from trueup.articulated.pose import quaternion_of, up_of
from trueup.ends import LOW, TILT
from trueup.engines.simulator import Simulator
from trueup.errors import ModelError, TrialError, unknown_name
from trueup.recording import Channel

if TYPE_CHECKING:
    from trueup.articulated.mirror import Posture
    from trueup.controllers.controller import Observation
    from trueup.controllers.keyframes import Degree, Motion, Tilt
    from trueup.engines.mujoco.model import Model
    from trueup.tasks.transitions import Transition


_LET_DOWN = np.linspace(-0.05, 0.15, 21)  # of the base's height in a keyframe, added to it: where it is let down from
_INTERVAL = 0.3  # s, a first guess


def transition(
    model: str | os.PathLike[str], start: str, goal: str, *, between: int | Sequence[str] = 1, searched: Sequence[str] = (),
    intervals: Sequence[float] = (), reach: float = 0.7, longest: float = 0.8, interpolation: str = "linear",
    feedback: Mapping[str, tuple[float, float]] | None = None, speeds: Mapping[str, float] | None = None,
    fitness: str = "repaired", step: float = 0.004, engine: str = "mujoco",
) -> tuple[Simulator, Transition]:  # fmt: skip
    """The simulator and the task of getting a humanoid from one keyframe of its MJCF to another, and of staying there.

    `start` and `goal` name keyframes (`<key name="kneel" qpos="..."/>`); a goal that is upside down is a handstand.
    `between`: how many poses are searched in between (evenly spread at first), or names of keyframes that they begin with.
    `searched`: which angles, by the joint's name without its side (default: all that turn in the plane of symmetry); both
    sides move alike. `intervals`: first guesses of the times between poses, in s; `reach` in rad. `feedback`: searched angles
    to the largest gains of tilt (rad/rad) and its rate (s). `speeds`: joint or searched angle to what its servo can do, in
    rad/s: no motion asks for more. `engine`: 'mujoco', or 'dart' (slower by far, other contacts).

    Raises UnknownNameError for names that are not there, ModelError without a free base, servos or symmetry, TrialError for
    a start that penetrates something or does not rest, ParameterError for poses beyond ranges or servos that are too slow.
    """
    simulator = _simulator(Path(model), engine, step)
    task = task_of(
        simulator, start, goal, between=between, searched=tuple(searched), intervals=tuple(intervals), reach=reach,
        longest=longest, interpolation=interpolation, feedback=feedback, speeds=speeds, fitness=fitness,
    )  # fmt: skip
    return simulator, task


def task_of(
    simulator: Simulator, start: str, goal: str, between: int | Sequence[str] = 1, searched: tuple[str, ...] = (),
    intervals: tuple[float, ...] = (), reach: float = 0.7, longest: float = 0.8, interpolation: str = "linear",
    feedback: Mapping[str, tuple[float, float]] | None = None, speeds: Mapping[str, float] | None = None,
    fitness: str = "repaired",
) -> Transition:  # fmt: skip
    """The same for a simulator that there is already: what a plan names as the task 'transition'. See `transition`."""
    from trueup.articulated.pose import ORIENTATION
    from trueup.controllers.keyframes import Motion, pitch_of
    from trueup.engines.dart.model import TURNING
    from trueup.engines.mujoco.base import free_joint
    from trueup.engines.mujoco.humanoid import commanded, posture, ranges
    from trueup.tasks.transitions import Transition

    model, dart = _model(simulator)
    first, last = posture(model, start), posture(model, goal)
    joints, (low, high) = commanded(model), ranges(model)
    degrees = _degrees(model, searched)
    names = () if isinstance(between, int) else tuple(between)
    count = between if isinstance(between, int) else len(names)
    shares = np.arange(1, count + 1)[:, None] / (count + 1)
    poses = (
        np.array([posture(model, n).joints for n in names])
        if names
        else first.joints + shares * (last.joints - first.joints)
    )
    columns = [joints.index(d.joints[0]) for d in degrees]
    motion = Motion(
        joints, first.joints, last.joints, degrees, poses.reshape(count, len(joints))[:, columns],
        np.array(intervals or [_INTERVAL] * (count + 1)), low, high, reach=reach, longest=longest,
        interpolation=interpolation, feedback=dict(feedback or {}), speeds=_speeds(joints, degrees, speeds),
    )  # fmt: skip
    joint = free_joint(model.compiled)
    tilt = pitch_of(int(model.compiled.jnt_qposadr[joint]) + 3, int(model.compiled.jnt_dofadr[joint]) + 3)
    if dart:
        tilt = _pitch_seen(ORIENTATION, TURNING)
    begun, ended = _rest(simulator, model, motion, first), _rest(simulator, model, motion, last)
    return Transition(
        f"{start}-to-{goal}", motion, begun, float(ended["base_position"].column("z")[0]), inverted=last.inverted,
        fitness=fitness, tilt=tilt if feedback else None,
    )  # fmt: skip


def _simulator(model: Path, engine: str, step: float) -> Simulator:
    from trueup.engines import dart
    from trueup.engines.mujoco.model import load
    from trueup.engines.mujoco.rollout import MujocoSimulator

    makers = {
        "mujoco": lambda: MujocoSimulator(load(model), step=step),
        "dart": lambda: dart.simulator(dart.load(model), step=step),
    }
    if engine not in makers:
        raise unknown_name("engine", engine, makers, "what simulates humanoids")
    return makers[engine]()


def _pitch_seen(angles: str, turning: str) -> Tilt:
    """The forward tilt of a free base from sensors of these names: roll, pitch, yaw in rad; rad/s about its axes."""

    def tilt(seen: Observation) -> tuple[Array, Array]:
        return seen.sensors[angles][:, 1], seen.sensors[turning][:, 1]

    return tilt


def _model(simulator: Simulator) -> tuple[Model, bool]:
    """The model that was read, and whether DART simulates it."""
    from trueup.articulated.simulator import ArticulatedSimulator
    from trueup.engines.dart.model import DartModel
    from trueup.engines.mujoco.rollout import MujocoSimulator
    from trueup.loop.restricted import Restricted

    whole = simulator.whole if isinstance(simulator, Restricted) else simulator
    if isinstance(whole, ArticulatedSimulator) and isinstance(whole.engine, DartModel):
        return whole.engine.file, True
    if not isinstance(whole, MujocoSimulator):
        raise ModelError(
            f"the task 'transition' reads poses from an MJCF file; simulator '{simulator.name}' was not made of one"
        )
    return whole.model, False


def _degrees(model: Model, searched: Sequence[str]) -> tuple[Degree, ...]:
    from trueup.controllers.keyframes import Degree
    from trueup.engines.mujoco.humanoid import mirrored

    known = {m.name: m for m in mirrored(model)}
    for name in searched:
        if name not in known:
            raise unknown_name("angle", name, known, f"what is alike on both sides of '{model.path.name}'")
    wanted = [known[n] for n in searched] or [m for m in known.values() if m.sagittal]
    return tuple(Degree(m.name, m.joints, m.signs) for m in wanted)


def _speeds(joints: Sequence[str], degrees: Sequence[Degree], speeds: Mapping[str, float] | None) -> Array | None:
    """(k,) rad/s by joints or searched angles; no limit where none is named."""
    if not speeds:
        return None
    known = {**{j: [j] for j in joints}, **{d.name: list(d.joints) for d in degrees}}
    out = np.full(len(joints), np.inf)
    for name, speed in speeds.items():
        if name not in known:
            raise unknown_name("joint", name, known, "what is commanded or searched")
        out[[joints.index(j) for j in known[name]]] = speed
    return out


def _rest(simulator: Simulator, model: Model, motion: Motion, pose: Posture) -> Mapping[str, Channel]:
    """The state in which the robot rests in a posture. Raises TrialError, which names what overlaps there."""
    from trueup.engines.mujoco.humanoid import overlap
    from trueup.loop.settle import settled

    heights = (pose.position[2] * (1.0 + _LET_DOWN)).tolist()
    (roll, pitch, _), (x, y) = pose.angles.tolist(), pose.position[:2].tolist()
    try:
        rest = settled(
            simulator, motion.joints, pose.joints, heights, roll=roll, pitch=pitch, at=(x, y), name=pose.name
        )
    except TrialError as error:
        touching = overlap(model, pose)
        raise TrialError(f"{error}" + (f" (in keyframe '{pose.name}' {touching})" if touching else "")) from None
    (ended,), height = rest["base_orientation"].values, float(rest["base_position"].column("z")[0])
    start, end = up_of(quaternion_of(np.array([pose.angles, ended])))
    turned = np.degrees(np.arccos(np.clip(start @ end, -1.0, 1.0)))
    if turned > np.degrees(TILT) or height < LOW * pose.position[2]:
        raise TrialError(
            f"pose '{pose.name}' falls over or sinks: its base ends {height:.3g} m high and turned by {turned:.0f} degrees, "
            f"in the keyframe it is {pose.position[2]:.3g} m high; move its feet below its weight"
        )
    return rest
