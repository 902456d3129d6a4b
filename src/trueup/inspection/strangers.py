# SPDX-License-Identifier: Apache-2.0
"""Joints of a log that its model does not have: those of a second robot, of a gripper that was left out of the model."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence

from trueup.errors import RecordingError
from trueup.recording import Channel, Recording, is_command

_GRIPPER = re.compile(r"grip|finger|jaw|claw|hand|tool", re.IGNORECASE)
_JOINTS = ("position", "velocity", "torque", "current")


def without_strangers(
    recordings: Sequence[Recording], drives: Mapping[str, str], others: Sequence[str] = ()
) -> tuple[list[Recording], list[str]]:
    """Recordings without joints that cannot be any of the model's, and a note that names them.

    That is where the log has every joint of the model, where a joint is the namesake of one that was found (another
    arm's), and grippers. Whatever else is not found stays: it may be a joint under another name, which must be said. So it
    may where all positions are found and no command is: what is commanded has names of its own then.
    `drives`: each joint of the model to the name of what drives it, '' where nothing does; `others`: further actuators.
    Raises RecordingError for a recording of which no joint would be left.
    """
    commanded, measured = _labels(recordings, commands=True), _labels(recordings, commands=False)
    labels = list(dict.fromkeys([*measured, *commanded]))
    known = {*drives, *filter(None, drives.values()), *others}
    found = [label for label in labels if label in known]
    complete = all(joint in labels or (drive and drive in labels) for joint, drive in drives.items())
    unclear = set[str]() if known & set(commanded) else set(commanded) - set(measured)
    gone = [
        label for label in labels if label not in known and found and (_GRIPPER.search(label) or label not in unclear)
        and (complete or _GRIPPER.search(label) or any(_namesake(label, joint) for joint in found))
    ]  # fmt: skip
    if not gone:
        return list(recordings), []
    for recording in recordings:
        there = dict.fromkeys(label for c in recording.channels.values() if _of_joints(c) for label in c.labels)
        if there and not set(there) & known and not set(there) - set(gone):
            raise RecordingError(
                f"recording '{recording.name}' has none of the model's joints ({', '.join(found)}), which others have; its "
                f"own are: {', '.join(there)}. Is it of another robot? Else rename them in [joints] of a mapping"
            )
    note = f"not in the model, and left out: {', '.join(gone)}"
    free = [drive for drive in others if drive not in labels]
    if free:  # the opening of a gripper has many names
        note += (
            f". The log does not name drives of several joints: {', '.join(free)}; if one is theirs, say so in [joints]"
        )
    return [_without(r, set(gone)) for r in recordings], [note]


def several_robots(labels: Sequence[str], joints: Collection[str]) -> str:
    """What to say where two labels of a log may be the same joint of the model; '' where none may."""
    for joint in joints:
        twins = [label for label in labels if _namesake(label, joint)]
        if len(twins) > 1:
            return (
                f"; this log seems to hold several robots ({', '.join(twins)}): name the joints of one in [joints], and "
                "those of the other are left out"
            )
    return ""


def _labels(recordings: Sequence[Recording], *, commands: bool) -> list[str]:
    """Labels of what joints were told, or of what was measured of them, each once."""
    channels = (c for r in recordings for c in r.channels.values() if _of_joints(c) and is_command(c.name) == commands)
    return list(dict.fromkeys(label for c in channels for label in c.labels))


def _of_joints(channel: Channel) -> bool:
    return channel.name in _JOINTS or is_command(channel.name)


def _namesake(label: str, joint: str) -> bool:
    """Whether a label is a joint's name with a part before or after it: right_joint1, joint1."""
    return label != joint and bool(re.search(rf"(^|[^A-Za-z0-9]){re.escape(joint)}($|[^A-Za-z0-9])", label))


def _without(recording: Recording, gone: set[str]) -> Recording:
    for channel in list(recording.channels.values()):
        kept = [label for label in channel.labels if label not in gone]
        if not _of_joints(channel) or len(kept) == len(channel.labels):
            continue
        recording = recording.with_channel(channel.select(kept)) if kept else recording.without(channel.name)
    return recording
