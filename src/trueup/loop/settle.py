# SPDX-License-Identifier: Apache-2.0
"""Brings a robot with a free base to rest in a pose: where a trial can begin without being thrown by its own floor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from trueup.arrays import Array
from trueup.engines.simulator import Rollout, Simulator
from trueup.errors import TrialError
from trueup.recording import Channel
from trueup.trial import LOOK, Observed, Trial

_FLOOR = 0.005  # m: contacts are soft by less; what rises by more was thrown out of something


def settled(
    simulator: Simulator, joints: Sequence[str], pose: Array, heights: Sequence[float], *, roll: float = 0.0,
    pitch: float = 0.0, at: tuple[float, float] = (0.0, 0.0), seconds: float = 2.0, name: str = "start",
) -> Mapping[str, Channel]:  # fmt: skip
    """'position', 'base_position' and 'base_orientation' of a robot that rests in `pose` (k,), in rad.

    It is let down from each of `heights` of its base, in m, above `at` (x, y) and turned by `roll` and `pitch` rad, and
    holds the pose for `seconds`; the lowest height from which nothing throws it up, and from which it comes to rest, counts.
    Raises TrialError where the pose penetrates something at all of them, or does not come to rest.
    """
    together = 4  # heights tried at once: an engine may take its time for each
    time = np.linspace(0.0, seconds, round(seconds / LOOK) + 1)
    restless, broken = list[TrialError](), list[str]()
    for first in range(0, len(heights), together):
        some = sorted(heights)[first : first + together]
        trials = [
            _let_down(tuple(joints), pose, (*at, float(z)), (roll, pitch), time, f"{name} from {z:.4g} m") for z in some
        ]
        for rollout, z in zip(simulator.rollout(trials, simulator.parameters.nominal[None]), some, strict=True):
            broken += rollout.failures.values()
            if not rollout.failures and rollout.channels["base_position"][0, :, 2].max() < z + _FLOOR:
                try:
                    return _at_rest(rollout, name)
                except TrialError as error:
                    restless.append(error)
    if restless:
        raise restless[0]
    if len(broken) == len(heights):
        raise TrialError(
            f"start pose '{name}' cannot be simulated at a step of {1e3 * simulator.step:.3g} ms from any height: {broken[0]}"
        )
    raise TrialError(
        f"start pose '{name}' penetrates the floor or what stands on it, or flies apart, at every height of the base from "
        f"{min(heights):.4g} to {max(heights):.4g} m: give higher ones, or another pose"
    )


def _let_down(
    joints: tuple[str, ...], pose: Array, place: tuple[float, float, float], turned: tuple[float, float], time: Array,
    name: str,
) -> Trial:  # fmt: skip
    start = np.zeros(1)
    return Trial(
        name=name, start=0.0, duration=float(time[-1]), command=Channel("command", joints, "rad", start, pose[None]),
        observed={
            "position": Observed(joints, "rad", time), "base_position": Observed(("x", "y", "z"), "m", time),
            "base_orientation": Observed(("roll", "pitch", "yaw"), "rad", time),
        },
        initial={
            "position": Channel("position", joints, "rad", start, pose[None]),
            "base_position": Channel("base_position", ("x", "y", "z"), "m", start, np.array([place])),
            "base_orientation": Channel(
                "base_orientation", ("roll", "pitch", "yaw"), "rad", start, np.array([[*turned, 0.0]])
            ),
        },
    )  # fmt: skip


def _at_rest(rollout: Rollout, name: str) -> Mapping[str, Channel]:
    """The last state of a run. Raises TrialError where it still moves."""
    last: dict[str, Channel] = {}
    for channel, o in rollout.trial.observed.items():
        values = rollout.channels[channel][0]
        if o.unit == "rad":  # a robot on its head rests where one angle may be told as another
            values = np.unwrap(values, axis=0)
        moving = np.abs(values[-1] - values[-round(0.1 / LOOK)]) / 0.1
        if moving.max() > 0.1:
            worst = int(moving.argmax())
            raise TrialError(
                f"start pose '{name}' does not come to rest: {channel} {o.labels[worst]} still moves by "
                f"{moving[worst]:.3g} {o.unit}/s and is at {values[-1, worst]:.3g} {o.unit} after {o.time[-1]:.3g} s"
            )
        last[channel] = Channel(channel, o.labels, o.unit, np.zeros(1), values[-1:])
    return last
