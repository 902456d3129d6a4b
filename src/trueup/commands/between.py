# SPDX-License-Identifier: Apache-2.0
"""What happens to commands between the samples of a log: held, as by a bus, or on the way from one to the next."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueup.calibration import Calibration
from trueup.instant import usual_step
from trueup.recording import Recording, is_command
from trueup.trial import command_of

HELD, INTERPOLATED = "held", "interpolated"


def add_between(parser: argparse.ArgumentParser) -> None:
    """The option of both `calibrate` and `replay`."""
    parser.add_argument("--commands", choices=(HELD, INTERPOLATED), default=HELD,
                        help="between their samples commands are held, as by a bus, or interpolated, as by a controller that "
                             "goes along a path (default: %(default)s)")  # fmt: skip


def with_commands_between(recordings: Sequence[Recording], between: str, step: float) -> list[Recording]:
    """Recordings with their commands interpolated at each `step` in s where that is asked for."""
    if between == HELD:
        return list(recordings)
    fine = []
    for recording in recordings:
        channels = dict(recording.channels)
        for name in (n for n in channels if is_command(n) and len(channels[n].time) > 1):
            c = channels[name]
            time = np.append(np.arange(c.time[0], c.time[-1], step), c.time[-1])
            channels[name] = replace(c, time=time, values=c.at(time))
        fine.append(recording.replace(channels=channels))
    return fine


def what_is_between(recordings: Sequence[Recording], between: str, step: float) -> list[str]:
    """A note on what is done between samples of commands, where these are further apart than `step` in s."""
    if between == INTERPOLATED:
        return ["commands are interpolated between their samples"]
    slow = _slow(recordings, step)
    words = f"commands are held for the {1e3 * max(slow):.3g} ms between their samples" if slow else ""
    return [f"{words} (--commands interpolated: on the way from one to the next)"] if slow else []


def sooner_than_held(calibration: Calibration, recordings: Sequence[Recording], step: float) -> tuple[str, ...]:
    """A note where no delay was left to find though commands were held between their samples: what was told more often than
    was logged follows half a sample sooner, for which damping and friction make up.
    """
    slow = _slow(recordings, step)
    none = [
        e for e in calibration.estimates if e.name.split(".")[-1] == "delay" and e.fitted and e.value <= e.lower_bound
    ]
    if not slow or not none:
        return ()
    return (
        f"no delay is left beside commands that are held for the {1e3 * max(slow):.3g} ms between their samples: was the "
        "robot told more often than was logged? --commands interpolated goes from one to the next; where errors are smaller "
        "so, take those values",
    )


def _slow(recordings: Sequence[Recording], step: float) -> list[float]:
    """Periods of commands in s, of those that are further apart than the step."""
    commands = (c for c in map(command_of, recordings) if c is not None and len(c.time) > 1)
    return [period for c in commands if (period := usual_step(c.time)) > 1.5 * step]
