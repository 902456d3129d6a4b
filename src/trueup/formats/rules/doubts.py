# SPDX-License-Identifier: Apache-2.0
"""What is said of a guess as a whole: what no name tells, labels that do not go together, joints that may be a base's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from trueup.formats.mapping import ChannelColumns
from trueup.formats.rules import joints
from trueup.formats.rules.families import of_base
from trueup.formats.rules.proposal import Proposal
from trueup.formats.rules.rule import Column
from trueup.formats.table import listing
from trueup.recording import is_command


def of_joints(channels: Mapping[str, ChannelColumns], groups: Mapping[str, Sequence[Proposal]]) -> list[str]:
    """Says where no name tells anything of joints, and where commands are of other joints than positions."""
    notes = []
    if not any(name.split("_")[0] in ("command", *joints.BY_KIND) for name in channels):
        found = listing(member.column.name for group in groups.values() for member in group)
        notes.append(f"no column's name says command, position, velocity, torque or current; columns are: {found}")
    command = channels.get("command")
    if command is not None and "position" not in channels and all(map(joints.COUNTED.fullmatch, command.labels)):
        notes.append(
            f"command: {listing(command.columns, 4)} has no names of joints, and no column is the position of one: if this "
            'drives a vehicle, say so in the mapping: labels = ["speed", "steering"] (or "throttle", "turn", ...), and '
            '[channels.position] with labels = ["x", "y"] for where it was'
        )
    if "command" in channels and "position" in channels:
        command, position = channels["command"].labels, channels["position"].labels
        if not set(command) & set(position):
            notes.append(
                f"command: its joints ({listing(command, 6)}) are none of position ({listing(position, 6)}): "
                "give labels that say which is which"
            )
    return notes


def put_aside(
    channels: Mapping[str, ChannelColumns], groups: Mapping[str, Sequence[Column]], *, driven: bool
) -> list[str]:
    """Says which columns with a word for positions, speeds or torques are no joint's, as their base may be a trunk."""
    aside = [
        column.name for name, group in groups.items()
        if name in channels and name not in joints.BY_KIND and not is_command(name)
        for column in group if of_base(column) and column.width == 1 and joints.read(column.parts).kind
    ]  # fmt: skip
    if driven or not aside:
        return []
    how = "a model given with the log says so by its names, or [channels.position] with labels in the mapping"
    return [f"{listing(aside, 6)}: taken for the pose of a base; if these are joints, {how}"]
