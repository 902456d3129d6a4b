# SPDX-License-Identifier: Apache-2.0
"""Which channels beside joints and commands may go into a prediction, and why others may not."""

from __future__ import annotations

from collections.abc import Sequence

from trueup.engines.simulator import Simulator
from trueup.inspection.inspection import motionless
from trueup.inspection.repeats import BASE
from trueup.inspection.sensors import is_accelerometer, is_gyro
from trueup.reckoned import reckoned_of
from trueup.recording import Recording, is_command

_OF_JOINTS = ("position", "velocity", "torque", "current", "acceleration")
_UNBOUNDED = ("x", "y", "yaw")  # of a free base: where it has walked to says nothing of its joints


def others_of(recordings: Sequence[Recording]) -> dict[str, tuple[str, ...]]:
    """Channels beside those of joints that all recordings have, each to its labels, without what has no bounds, and what was
    reckoned from joints, which a simulator does not show.
    """
    found = {}
    reckoned = {name for r in recordings for name in reckoned_of(r)}
    for name in recordings[0].channels:
        if is_command(name) or name in (*_OF_JOINTS, *reckoned) or not all(r.has(name) for r in recordings):
            continue
        first, *more = [r.channel(name).labels for r in recordings]
        labels = tuple(x for x in first if all(x in each for each in more))
        kept = tuple(x for x in labels if not (name.startswith("base_") and x in _UNBOUNDED))
        if kept:
            found[name] = kept
    return found


def telling_nothing(recordings: Sequence[Recording]) -> dict[str, str]:
    """Channels of `others_of` that can foretell no joint, each to why.

    What shows nothing but noise tells nothing. An accelerometer tells how a base leans and is pushed; where the base is held
    there is neither, and joints tell where all else is.
    """
    found, others = dict[str, str](), others_of(recordings)
    for name, labels in others.items():
        if all(set(motionless(r.channel(name).select(labels))) == set(labels) for r in recordings):
            found[name] = "shows nothing but noise"
    held = not any(name in (*BASE, "com") or is_gyro(name) for name in others if name not in found)
    for name in others:
        if held and name not in found and any(is_accelerometer(r.channel(name)) for r in recordings):
            found[name] = "is an accelerometer's, and nothing in the recordings says that the base moves"
    return found


def as_shown(recordings: Sequence[Recording], simulator: Simulator) -> tuple[list[Recording], list[str]]:
    """Recordings without channels beside those of joints that a simulator does not show to its controllers, and a note."""
    result, left = list[Recording](), dict[str, None]()
    for recording in recordings:
        shown = simulator.observable(recording)
        unseen = [name for name in others_of([recording]) if name not in shown]
        left |= dict.fromkeys(unseen)
        result.append(recording.replace(channels={n: c for n, c in recording.channels.items() if n not in unseen}))
    note = f"not looked at, since '{simulator.name}' does not show it to controllers: {', '.join(left)}"
    return result, [note] if left else []
