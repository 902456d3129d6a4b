# SPDX-License-Identifier: Apache-2.0
"""Where in a log the run begins that was asked for: logs are started early, and hold commands or do not."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.articulated.pose import ANGLES, ORIENTATION, QUATERNION, in_angles
from trueup.instant import usual_step
from trueup.recording import Channel, Recording, is_command, with_warnings
from trueup.trial import Trial


def as_observed(trial: Trial, recording: Recording) -> Recording:
    """The recording, a base's orientation in angles where these are observed and the log has quaternions, as motion
    capture does.
    """
    if ORIENTATION not in trial.observed or not recording.has(ORIENTATION):
        return recording
    asked, told = trial.observed[ORIENTATION].labels, recording.channel(ORIENTATION).labels
    return in_angles(recording) if set(asked) == set(ANGLES) and set(told) == set(QUATERNION) else recording


def completed(trial: Trial, recording: Recording) -> Recording:
    """The recording as it is observed, from where the run begins in it, with the command that was requested; that this
    is so is kept with it.
    """
    asked, recording = trial.command, as_observed(trial, recording)
    if asked is None:
        return recording
    logged = next((recording.channel(n) for n in ("command", "command_sent") if recording.has(n)), None)
    if logged is not None:
        early = begins(asked, logged)
        start = float(logged.time[0]) + early
        return recording.slice(start, start + trial.duration + 1.0) if early > 0.0 else recording
    sent = asked.replace(name="command", time=asked.time - trial.start + recording.start)
    told = with_warnings(recording.provenance, (
        "the log holds no command: what was requested is taken as sent from the log's first sample on, so a delay cannot be "
        "told from a log that was started late",
    ))  # fmt: skip
    return Recording(recording.name, {"command": sent, **recording.channels}, told)


def begins(asked: Channel, done: Channel) -> float:
    """How long a recorded channel lasts before what was asked begins in it, in s: a log may be started early."""
    request, grid = _request(asked)
    picked = done.select(list(asked.labels))
    spare = max(0.0, float(done.time[-1] - done.time[0]) - float(grid[-1]))
    best, least = 0.0, np.inf
    for offset in np.linspace(0.0, spare, 1 + min(400, round(spare / 0.02))):
        sent = picked.at(done.time[0] + offset + grid, hold=True)
        size = float(
            np.nanmean((np.sort(sent, axis=1) - np.sort(request, axis=1)) ** 2)
        )  # blind to the order of joints
        if size < least:
            best, least = float(offset), size
    return best


def side_by_side(asked: Channel, done: Channel) -> tuple[Array, Array]:
    """(T, k) what was asked and what was recorded, on the request's instants from its start, wherever that lies."""
    request, grid = _request(asked)
    sent = done.select(list(asked.labels)).at(done.time[0] + begins(asked, done) + grid, hold=is_command(done.name))
    return request, np.nan_to_num(sent)


def _request(asked: Channel) -> tuple[Array, Array]:
    """(T, k) the command held at up to a few thousand instants, and these (T,), from its start."""
    time = asked.time - asked.time[0]
    step = max(0.01, usual_step(time) if len(time) > 1 else 0.01, float(time[-1]) / 4000)
    grid = np.arange(0.0, time[-1], step)
    return asked.at(asked.time[0] + grid, hold=True), grid
