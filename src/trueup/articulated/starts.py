# SPDX-License-Identifier: Apache-2.0
"""Where a run began and how fast, from the first measured samples."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import isfinite

import numpy as np

from trueup.arrays import Array
from trueup.articulated.model import BasePose, Model
from trueup.articulated.pose import ANGLES, AXES, ORIENTATION, POSITION, RATES, headed
from trueup.instant import at_instant
from trueup.recording import Channel
from trueup.trial import Trial


def measured_base(trial: Trial) -> BasePose | None:
    """The pose of a free base at the trial's start, where its position and angles (`pose.in_angles`) were measured."""
    position, orientation = trial.initial.get(POSITION), trial.initial.get(ORIENTATION)
    if position is None or orientation is None or orientation.labels != ANGLES:
        return None
    states = []
    ordered = position if position.labels == AXES else position.select(AXES)  # the same channel is not looked at again
    for channel, rates in ((ordered, None), (orientation, trial.initial.get(RATES))):
        begun = at_instant(channel, rates, trial.start)
        state = np.array([begun.value, begun.speed])
        if channel.name in trial.corrections:
            labels = trial.initial[channel.name].labels
            state += trial.corrections[channel.name][:, [labels.index(n) for n in channel.labels]]
        states += list(state if channel is ordered else headed(state))
    return BasePose(*states)


def gone_on(trial: Trial, joint: str, late: Array) -> tuple[Array, Array]:
    """(b,), (b,) how much further a joint had come, and how much faster it was, where a trial begins, than its own sensor
    tells that is `late` (b,) s: by what that one tells later.
    """
    position, velocity = (_of_one(trial.initial.get(name), joint) for name in ("position", "velocity"))
    if position is None:
        return np.zeros(len(late)), np.zeros(len(late))
    every, again = np.unique(np.append(late, 0.0), return_inverse=True)
    instants = [at_instant(position, velocity, trial.start + seconds) for seconds in every.tolist()]
    states = np.array([(i.value[0], i.speed[0]) for i in instants])[again]
    place, pace = np.nan_to_num(states[:-1] - states[-1]).T
    return place, pace


@lru_cache(maxsize=2**10)  # the same channel is not looked at again
def _of_one(channel: Channel | None, joint: str) -> Channel | None:
    return channel.select([joint]) if channel is not None and channel.unit and joint in channel.labels else None


def at_rest(model: Model) -> tuple[Array, Array]:
    """(k,), (k,) positions and velocities of the joints of `model.drives()` where the model begins."""
    place, pace = ([model.get(f"joint.{a}", j)[0] for j in model.drives()] for a in ("start", "start_velocity"))
    return np.array(place, dtype=np.float64), np.array(pace, dtype=np.float64)


def measured_start(
    rest: tuple[Array, Array], trial: Trial, joints: Sequence[str], step: float = 0.0
) -> tuple[Array, Array]:
    """(k,), (k,) positions and velocities of `joints` at the trial's start, from its recording, as steps of `step` s have
    them (`Instant.speed_of_steps`); else those of `rest`.
    """
    place, pace = (np.array(r) for r in rest)
    position, velocity = trial.initial.get("position"), trial.initial.get("velocity")
    velocity = velocity if velocity is not None and velocity.unit else None
    seen = set[str]()
    if position is not None:
        begun = at_instant(position, velocity, trial.start)
        values, speeds = np.array([begun.value, begun.speed_of_steps(step)]) + trial.corrections.get("position", 0.0)
        for label, q, dq in zip(position.labels, values.tolist(), speeds.tolist(), strict=True):
            if label in joints and isfinite(q):
                place[joints.index(label)], pace[joints.index(label)] = q, dq
                seen.add(label)
    if velocity is not None and not seen.issuperset(velocity.labels):
        for label, v in zip(velocity.labels, at_instant(velocity, None, trial.start).value, strict=True):
            if label in joints and label not in seen and np.isfinite(v):
                pace[joints.index(label)] = v
    return place, pace
