# SPDX-License-Identifier: Apache-2.0
"""Guesses which columns are which channels, from their names, their file's name and the size of their numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.errors import MappingError
from trueup.formats.clocks import Clocks, find_clocks
from trueup.formats.counts import COUNTS_NOTE, are_counts, in_counts
from trueup.formats.mapping import ChannelColumns, ChannelMap
from trueup.formats.pose import as_pose
from trueup.formats.table import Table, listing
from trueup.formats.vehicle import as_vehicle
from trueup.formats.words import VOCABULARY, Meaning, joint_labels, label_of, meaning, with_actual, words
from trueup.recording import is_command
from trueup.units import to_si

Array = NDArray[np.float64]

# Joints of arms and legs stay within about two turns; larger numbers are another unit, or a motor before its gear.
_LARGEST_ANGLE = 4.0 * math.pi


@dataclass(frozen=True)
class _Column:
    table: Table
    name: str
    role: str
    label: str
    unit: str
    clock: str
    """'' for the table's main clock."""

    @property
    def width(self) -> int:
        return self.table.width(self.name)

    @property
    def largest(self) -> float:
        values = np.abs(self.table.columns[self.name])
        finite = values[np.isfinite(values)]
        return float(finite.max()) if finite.size else 0.0


def guess(tables: Sequence[Table]) -> ChannelMap:
    """A mapping for these tables (files or topics of one recording), with notes on what is not sure.

    Raises MappingError, saying what was found, where no column but time holds numbers.
    """
    clocks = find_clocks(tables)
    read = with_actual([name for table in tables for name in table.columns])
    columns = [
        column
        for table in tables
        for name in table.columns
        if (column := _column(table, name, read[name], tables, clocks))
    ]
    if not columns:
        found = "; ".join(f"{t.name}: {listing(t.columns)}" for t in tables)
        raise MappingError(f"no column but time holds numbers, so there is no channel; found {found}")
    groups = _groups(columns, several=len(tables) > 1)
    channels = {
        name: _channel(group, clocks, tables) for name, group in sorted(groups.items(), key=lambda g: _order(g[0]))
    }
    channels, notes = _with_units(channels, groups)
    said = [*_notes(channels, groups), *notes]
    named, more = as_vehicle(channels, tables)
    if more:
        made = set(named) - {note.split(":")[0] for note in more} - {"command"}
        said = [note for note in said if note.split(":")[0] in made]
        named = dict(sorted(named.items(), key=lambda item: _order(item[0])))
    else:
        cells = {name: {m.name: m.table.columns[m.name] for m in group} for name, group in groups.items()}
        named, more = as_pose(named, cells)
    return ChannelMap(channels=named, time=clocks.main, notes=(*clocks.notes, *said, *more))


def _column(table: Table, name: str, read: str, tables: Sequence[Table], clocks: Clocks) -> _Column | None:
    """What a column seems to be, its name `read` so; None for clocks and columns without a number."""
    values = table.columns[name]
    if name in clocks.columns.get(table.name, ()) or not np.any(np.isfinite(values)) or _counts_rows(name, values):
        return None
    said = meaning(read)
    context = meaning(_stem(table.name)) if len(tables) > 1 else None
    role = _role(name, said, context, table)
    label = label_of(said.label) if role else ""
    if role in ("voltage", "temperature") and not said.label:
        label = role  # more often of the supply than of a joint
    if not role:
        role, label = _own_name(name, table, len(tables) > 1)
    unit = said.unit or table.units.get(name, "")
    return _Column(table, name, role, label, unit, clocks.clock_of(table, name))


def _counts_rows(name: str, values: Array) -> bool:
    """Whether a column without a name only numbers the rows, as pandas writes it."""
    if not name.startswith("column_") or values.ndim != 1 or len(values) < 2 or values[0] not in (0.0, 1.0):
        return False
    return bool(np.all(np.diff(values) == 1.0))


def _role(name: str, said: Meaning, context: Meaning | None, table: Table) -> str:
    """command, position, ...; '' where no word tells."""
    plain = words(name)
    if not said.joint or (context is not None and not context.joint) or _of_floating_base(plain, table.columns[name]):
        return ""
    kind, command, sent = said.kind, said.command, said.sent
    if context is not None:
        kind = kind or context.kind
        command = command or (context.command and not _tells_measured(_stem(table.name)))
        sent = sent or context.sent
    vector = table.columns[name].ndim == 2 or ("observation" in plain and plain[-1].isdigit())
    if not kind and not command and vector and "state" in plain:
        kind = "position"  # LeRobot's observation.state, also one number a column
    if command:
        base = "command_sent" if sent else "command"
        return base if kind in ("", "position") else f"{base}_{kind}"
    return kind


def _tells_measured(topic: str) -> bool:
    """Whether a topic's or file's name says that it was measured; "joint_commands" does not."""
    return bool(set(words(topic)) & (VOCABULARY.measured - {"joint", "joints", "motor", "motors"}))


def _of_floating_base(plain: Sequence[str], values: Array) -> bool:
    """Whether "base" means a trunk with a pose of several numbers, and not an arm's first joint."""
    return "base" in plain and (values.ndim > 1 or any(word in VOCABULARY.axes or word.isdigit() for word in plain))


def _own_name(name: str, table: Table, several: bool) -> tuple[str, str]:
    """Channel name and label of a column without a role; those that differ by an axis or index go together."""
    plain = words(name)
    tail = [word for word in plain if word in VOCABULARY.axes or word.isdigit()]
    head = [word for word in plain if word not in tail]
    prefix = "_".join(words(_stem(table.name))) + "_" if several else ""
    if not head or not tail:
        own = "_".join(plain) or name
        return prefix + own, own
    return prefix + "_".join(head), "_".join(tail)


def _groups(columns: Sequence[_Column], *, several: bool) -> dict[str, list[_Column]]:
    """Columns by channel. A second family for a role already taken gets a name of its own."""
    families: dict[tuple[str, str, str, str, bool], list[_Column]] = {}
    for column in columns:
        key = (
            column.role,
            column.table.name,
            column.clock,
            _family(column),
            column.table.columns[column.name].ndim > 1,
        )
        families.setdefault(key, []).append(column)
    groups: dict[str, list[_Column]] = {}
    for (role, table, _, family, _), members in sorted(families.items(), key=lambda f: -_weight(f[1])):
        name = role
        if name in groups:
            first = groups[role][0].table.name
            extra = _stem(table) if several and table != first else family or members[0].name
            name = "_".join([role, *words(extra)])
        while name in groups:
            name += "_2"
        groups[name] = _distinct(members)
    return groups


def _family(column: _Column) -> str:
    """Signals of motors are kept apart from those of joints, raw ones from filtered ones, where a file has both."""
    return next((word for word in ("motor", "raw", "unfiltered", "filtered") if word in words(column.name)), "")


def _weight(members: Sequence[_Column]) -> int:
    return sum(member.width for member in members)


def _distinct(members: Sequence[_Column]) -> list[_Column]:
    """Members with distinct labels; where two would have the same, the columns' names are the labels."""
    labels = [member.label for member in members]
    if len(set(labels)) == len(labels):
        return list(members)
    return [replace(member, label=member.name) for member in members]


def _channel(group: Sequence[_Column], clocks: Clocks, tables: Sequence[Table]) -> ChannelColumns:
    table = group[0].table
    width = clocks.widths.get(table.name, 0)
    units = {member.unit for member in group}
    mixed = len(units) > 1 and all(u and to_si(u)[0] in ("rad", "m") for u in units)
    return ChannelColumns(
        columns=tuple(member.name for member in group),
        file=table.name if len(tables) > 1 else "",
        labels=_labels(group, width),
        width=width,
        unit=group[0].unit if len(units) == 1 else "rad" if mixed else "",
        # Hinges in degrees beside a slide in millimetres: each number to rad or m by itself.
        scale=tuple(to_si(member.unit)[1] for member in group for _ in range(member.width)) if mixed else (1.0,),
        **clocks.keys_of(table, group[0].clock),
    )


def _labels(group: Sequence[_Column], width: int) -> tuple[str, ...]:
    if width > 1:
        return tuple(f"joint_{i + 1}" for i in range(width))
    if all(member.width == 1 for member in group):
        return tuple(member.label for member in group)
    total = _weight(group)
    table = group[0].table
    if len(group) == 1 and group[0].name in table.named:
        return joint_labels(table.named[group[0].name])
    known = table.labels
    return known if len(known) == total else tuple(f"joint_{i + 1}" for i in range(total))


def _with_units(
    channels: dict[str, ChannelColumns], groups: dict[str, list[_Column]]
) -> tuple[dict[str, ChannelColumns], list[str]]:
    """Units that the files do not declare, where the size of the numbers allows a guess; else a note."""
    result, notes = dict(channels), []
    joints: set[tuple[str, ...]] = set()
    counts = _in_counts(channels, groups)
    for name in ("position", "command", "command_sent"):
        if name not in channels:
            continue
        if counts and not channels[name].unit:
            result[name] = in_counts(channels[name])
            joints.add(channels[name].labels)
            notes.append(f"{name}: {COUNTS_NOTE}")
            continue
        largest = max(member.largest for member in groups[name])
        if channels[name].unit in ("rad", "deg"):
            joints.add(channels[name].labels)
        elif not channels[name].unit and name == "command" and "position" not in channels:
            notes.append("command: unit unknown (there is no position to compare with)")
        elif not channels[name].unit and largest <= _LARGEST_ANGLE:
            result[name] = replace(channels[name], unit="rad")
            joints.add(channels[name].labels)
            notes.append(f"{name}: taken as rad (largest value {largest:.3g}); say so if it is m or anything else")
        elif not channels[name].unit:
            notes.append(
                f"{name}: unit unknown; values reach {largest:.4g}: degrees are suspected, or motors before their gears"
            )
    sizes = {"velocity": "rad/s", "torque": "N m", "command_velocity": "rad/s", "command_torque": "N m"}
    for name, unit in sizes.items():
        if name in channels and not channels[name].unit:
            if channels[name].labels in joints and result.get("position", channels[name]).unit == "rad":
                result[name] = replace(channels[name], unit=unit)
                notes.append(f"{name}: taken as {unit}; say so if it is anything else")
            else:
                notes.append(f"{name}: unit unknown")
    if "current" in channels and not channels["current"].unit:
        notes.append("current: unit unknown: say A or mA")
    return result, notes


def _in_counts(channels: dict[str, ChannelColumns], groups: dict[str, list[_Column]]) -> bool:
    """Whether the measured positions are counts of an encoder."""
    measured = groups.get("position", [])
    if not measured or channels["position"].unit:
        return False
    return are_counts([member.table.columns[member.name] for member in measured])


def _notes(channels: dict[str, ChannelColumns], groups: dict[str, list[_Column]]) -> list[str]:
    notes = []
    if not any(name.split("_")[0] in ("command", *set(VOCABULARY.kinds.values())) for name in channels):
        found = listing(member.name for group in groups.values() for member in group)
        notes.append(f"no column's name says command, position, velocity, torque or current; columns are: {found}")
    if "command" in channels and "position" in channels:
        command, position = channels["command"].labels, channels["position"].labels
        if not set(command) & set(position):
            notes.append(
                f"command: its joints ({listing(command, 6)}) are none of position ({listing(position, 6)}): "
                "give labels that say which is which"
            )
    for name, channel in channels.items():
        mixed = sorted({to_si(member.unit)[0] for member in groups[name]})
        if len(mixed) > 1 and channel.unit:
            notes.append(f"{name}: its columns have different units; `scale` makes rad of angles and m of lengths")
        elif len(mixed) > 1:
            notes.append(f"{name}: its columns have different units ({listing(mixed)}); split it: {channel.columns}")
    return notes


def _order(name: str) -> tuple[int, str]:
    """Commands first, then what was measured, then the rest."""
    usual = ("position", "velocity", "acceleration", "torque", "current")
    if is_command(name):
        return (0, name)
    return (1 + usual.index(name), name) if name in usual else (10, name)


def _stem(name: str) -> str:
    return name.rsplit(".", 1)[0] if "." in name and not name.startswith("/") else name
