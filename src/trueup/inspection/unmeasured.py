# SPDX-License-Identifier: Apache-2.0
"""What a recording lacks of what was to be observed in it: stretches without values that are too long to be bridged."""

from __future__ import annotations

import numpy as np

from trueup.ends import end_of
from trueup.inspection.repeats import LONGEST_GAP, lost
from trueup.instant import usual_step
from trueup.recording import Channel, Recording, is_command
from trueup.trial import Trial


def unmeasured(trial: Trial, recording: Recording) -> list[str]:
    """One sentence for each stretch of `LONGEST_GAP` or longer in which observed channels have no values; [] without any.

    What comes after an end of the trial (the robot fell) does not count. A command holds until the next one, so it lacks
    values only where it has none at all. Raises UnknownNameError where the recording lacks a channel or label.
    """
    gaps: dict[tuple[float, float], list[str]] = {}
    end = end_of(recording, trial.ends)
    for name, o in trial.observed.items():
        gap = _gap(recording.channel(name).select(o.labels), recording.stop if end is None else end.at)
        if gap is not None:
            gaps.setdefault((gap[0] - recording.start, gap[1] - recording.start), []).append(f"'{name}'")
    return [
        f"{' and '.join(names)} {'has' if len(names) == 1 else 'have'} no values from {first:.4g} to {last:.4g} s after its "
        f"start ({last - first:.2g} s; at most {LONGEST_GAP:g} s can be bridged)"
        for (first, last), names in gaps.items()
    ]


def _gap(channel: Channel, stop: float) -> tuple[float, float] | None:
    """From when to when a channel lacks values before `stop`, in s."""
    there = channel.time <= stop
    if not there.any():
        return None
    channel = channel.replace(time=channel.time[there], values=channel.values[there])
    known = np.isfinite(channel.values).all(axis=1)
    if is_command(channel.name):
        return None if known.any() else (float(channel.time[0]), float(channel.time[-1]))
    slow = (
        known.sum() > 2 and usual_step(channel.time[known]) >= LONGEST_GAP
    )  # throughout: nothing is missing in between
    return None if slow else lost(channel)
