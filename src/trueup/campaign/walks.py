# SPDX-License-Identifier: Apache-2.0
"""A walk of one's own biped as a task, from a model file and the names of its legs' joints, in a world that disturbs it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from trueup.arrays import Array
from trueup.chance import Buffeting, CommandNoise, Disturbance, Sensing
from trueup.engines.simulator import Simulator
from trueup.errors import ModelError, ParameterError, TrialError, unknown_name
from trueup.parameters import ParameterSpace

if TYPE_CHECKING:
    from trueup.engines.mujoco.model import Model
    from trueup.tasks.walking import Walk

AnyWalk = TypeVar("AnyWalk", bound="Walk")


@dataclass(frozen=True)
class Unrest:
    """What a simulated walk is disturbed by, so that what walks there has a margin."""

    push: float | None = None
    """N, deviation of a force on the base that wanders; None: `share` of the robot's weight."""
    zero: float = 0.008
    """rad, deviation by which each joint of a leg is off throughout a run."""
    gyro: float = 0.03
    """rad/s, noise."""
    drift: float = 0.01
    """rad/s, deviation by which gyros are off throughout a run."""
    accelerometer: float = 0.3
    """m/s2, noise."""
    share: float = 0.02

    def disturbances(self, model: Model, base: str, motors: Sequence[str]) -> tuple[Disturbance, ...]:
        """Of a model whose base is this body and whose legs are moved by these joints' motors."""
        m = model.compiled
        weight = float(m.body_subtreemass[0]) * float(abs(m.opt.gravity[2]))
        push = self.share * weight if self.push is None else self.push
        return Buffeting(base, push), CommandNoise(self.zero, tuple(motors), every=1e3)

    def sensing(self, latency: float, gyro: str = "gyro", accelerometer: str = "accelerometer") -> tuple[Sensing, ...]:
        """Of gyros and accelerometer of these names that are `latency` s late."""
        return (
            Sensing(gyro, self.gyro, latency, bias=self.drift),
            Sensing(accelerometer, self.accelerometer, latency),
        )


COURSES = ("front", "line", "around")


def walk(
    model: str | os.PathLike[str], left: Sequence[str], right: Sequence[str], *, step: float | None = None,
    course: str = "front", **options: float | Mapping[str, float] | None,
) -> tuple[Simulator, Walk]:  # fmt: skip
    """The simulator and the task of walking with a biped's MJCF: straight ahead ('front'), to a line ('line'), through a
    course of targets in all directions ('around').

    `left` and `right` name the joints of each leg from the hip down: yaw, roll, pitch, knee, ankle pitch, ankle roll. The
    model needs a free base (x forward, z up), position servos, a first keyframe in which it stands, and a gyro and an
    accelerometer, mounted anyhow. `step` of integration in s (None: the model's own, at most 5 ms). Options as those of a
    plan's task 'walk' (see `task_of`).

    Raises ModelError for what is missing or built otherwise, UnknownNameError for joints and courses that are not there,
    ParameterError for start values that no walk has.
    """
    from trueup.engines.mujoco.model import load
    from trueup.engines.mujoco.rollout import MujocoSimulator

    read = load(Path(model))
    # Light feet and rotors shake at steps that are longer than those their file was made for, and a walk falls by it.
    simulator = MujocoSimulator(read, step=read.own_step if step is None else step)
    return simulator, task_of(simulator, tuple(left), tuple(right), course, **options)  # type: ignore[arg-type]


def task_of(
    simulator: Simulator, left: tuple[str, ...], right: tuple[str, ...], course: str = "front", share: float = 0.67,
    runs: int = 7, seed: int = 0, period: float = 0.01, fall: float | None = None, quiet: bool = False,
    nominal: Mapping[str, float] | None = None, laps: int = 1,
) -> Walk:  # fmt: skip
    """The same for a simulator that there is already: what a plan names as the task 'walk'. See `walk`.

    `share` of the largest step; means over `runs` disturbed runs (undisturbed ones if `quiet`); a command every `period` s;
    `fall`: what a fall costs, in m/s, of a course in m; `nominal`: start values of the walk's parameters, by name; `laps`:
    how many lines lie behind one another, of the course 'line'.
    """
    from trueup.controllers.walk_engine.engine import sized
    from trueup.engines.mujoco.biped import biped_of
    from trueup.tasks.omni_walk import OmniWalk
    from trueup.tasks.walking import LineWalk, WalkFront

    kinds: dict[str, type[Walk]] = {"front": WalkFront, "line": LineWalk, "around": OmniWalk}
    if course not in kinds:
        raise unknown_name("course", course, COURSES, "what the task 'walk' knows")
    own: dict[str, object] = {} if fall is None else {"fall": fall}
    if laps != 1 and course != "line":
        raise TrialError(f"laps = {laps}: only the course 'line' has laps, not '{course}'")
    own |= {"laps": laps} if course == "line" else {}
    model = model_of(simulator)
    own["parameters"] = sized(float(biped_of(model, left, right).legs.longest.mean()))
    made = walking(
        model, left, right, kinds[course], unrest=None if quiet else Unrest(), period=period, share=share,
        runs=runs, seed=seed, **own,
    )  # fmt: skip
    return replace(made, parameters=_begun_with(made.parameters, nominal or {}))


def _begun_with(space: ParameterSpace, values: Mapping[str, float]) -> ParameterSpace:
    """A walk's parameters with the start values that a robot walks with. Bounds hold these, and as much around them as around
    the engine's own: cut by a bound a start value would be another, and bolder paces would be none.
    """
    begun = list(space.parameters)
    for name, value in values.items():
        p = begun[k := space.index(name)]
        by = value / p.nominal if p.lower > 0.0 else 1.0
        widest = (
            (p.lower**2 / p.upper, p.upper**2 / p.lower)
            if p.lower > 0.0
            else (2 * p.lower - p.upper, 2 * p.upper - p.lower)
        )
        if not widest[0] <= value <= widest[1]:
            raise ParameterError(
                f"nominal: {name} = {value:g} {p.unit} is no start value of a walk: bipeds of this size have {p.lower:.3g} "
                f"to {p.upper:.3g} {p.unit}, and as far again beyond is taken. Is it in {p.unit}?"
            )
        begun[k] = p.replace(
            nominal=value, lower=min(p.lower, by * p.lower, value), upper=max(p.upper, by * p.upper, value)
        )
    return ParameterSpace(tuple(begun))


def walking(
    model: Model, left: Sequence[str], right: Sequence[str], kind: type[AnyWalk], *, unrest: Unrest | None = None,
    period: float = 0.01, **fields: object,
) -> AnyWalk:  # fmt: skip
    """A walking task of a model; `fields` are those of `kind` (`share`, `runs`, `seed`, ...)."""
    from trueup.controllers.walk_engine.attitude import Complementary
    from trueup.controllers.walk_engine.engine import PARAMETERS, WalkEngine, stepping_speed
    from trueup.engines.mujoco.base import free_joint
    from trueup.engines.mujoco.biped import biped_of, inertial
    from trueup.tasks.walking import AheadWalk

    robot, m = biped_of(model, left, right), model.compiled
    (gyro, turned), (accelerometer, tilted) = inertial(model).values()
    if not m.nkey:
        raise ModelError(
            f"model '{model.name}' has no keyframe to start from: add one in which it stands on slightly bent legs"
        )
    joint = free_joint(m)
    motors = [
        n for side, joints in enumerate(robot.legs.joints) for j, n in enumerate(joints) if robot.columns[side, j] >= 0
    ]
    base = model.names("body")[int(m.jnt_bodyid[joint])]

    def make(values: Array) -> WalkEngine:
        attitude = Complementary(gyro, accelerometer, mounted=(turned, tilted))
        return WalkEngine(robot, values, period=period, attitude=attitude)

    longest = float(robot.legs.longest.mean())
    steps = {"steps": lambda values: stepping_speed(values, longest)} if issubclass(kind, AheadWalk) else {}
    own: dict[str, object] = {
        "parameters": PARAMETERS, "make": make, "height": float(m.key_qpos[0, m.jnt_qposadr[joint] + 2]),
        "sensing": [Sensing(s, latency=period) for s in (gyro, accelerometer)] if unrest is None else
                   unrest.sensing(period, gyro, accelerometer),
        "disturbances": () if unrest is None else unrest.disturbances(model, base, motors), **steps, **fields,
    }  # fmt: skip
    return kind(**own)  # type: ignore[arg-type]


def model_of(simulator: Simulator) -> Model:
    """The MuJoCo model behind a simulator. Raises ModelError where there is none."""
    from trueup.engines.mujoco.rollout import MujocoSimulator
    from trueup.loop.restricted import Restricted

    whole = simulator.whole if isinstance(simulator, Restricted) else simulator
    if not isinstance(whole, MujocoSimulator):
        raise ModelError(f"the task 'walk' reads legs from a MuJoCo model; simulator '{simulator.name}' has none")
    return whole.model
