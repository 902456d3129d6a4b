# SPDX-License-Identifier: Apache-2.0
"""Chooses what the columns of a log are: rules propose by their names, numbers check, and what is not sure is said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from trueup.arrays import Array
from trueup.errors import MappingError
from trueup.formats.mapping import ChannelColumns, ChannelMap
from trueup.formats.rules import autopilots, bases, doubts, joints
from trueup.formats.rules.clocks import Clocks, find_clocks
from trueup.formats.rules.coherence import (
    distinct,
    family_of,
    with_common_labels,
    with_twins,
    without_doubles,
    without_other_signals,
    without_places,
    without_sensors,
)
from trueup.formats.rules.context import in_context
from trueup.formats.rules.drive import Part, drive, ridden
from trueup.formats.rules.families import Named, joints_in, of_base
from trueup.formats.rules.inertial import sensor_labels
from trueup.formats.rules.lists import in_parts, without_other_lists
from trueup.formats.rules.names import AXES, axes, listed, stem, taken_apart, words
from trueup.formats.rules.proposal import Proposal, own_words, unchanged
from trueup.formats.rules.rule import Column
from trueup.formats.rules.sizes import Sizes
from trueup.formats.table import Table, listing
from trueup.recording import is_command
from trueup.units import are_pulses

_COUNTERS = frozenset(["header", "seq", "field", "stamp", "h"])
"""Words of a column that counts messages."""
_OF_ROWS = listed(
    "idx index i k n nr no number row line sample samples count counter frame packet step iteration iter id"
)
"""Words of a column that may number the rows: whether it does its numbers say."""
_OF_VEHICLES = ("position", "velocity", "acceleration", "command")
"""Kinds that a vehicle's log has under its own names: what is left of them there is no joint's."""


def guess(tables: Sequence[Table], known: Sequence[str] | None = ()) -> ChannelMap:
    """A mapping for these tables (files or topics of one recording), with notes on what is not sure.

    `known`: joints of the model that the log is of, whose exact names mean nothing else; None where that is a vehicle.
    Raises MappingError, saying what was found, where no column but time holds numbers.
    """
    clocks = find_clocks(tables)
    columns = _columns(tables, clocks, known or ())
    if not columns:
        found = "; ".join(f"{t.name}: {listing(t.columns)}" for t in tables)
        raise MappingError(f"no column but time holds numbers, so there is no channel; found {found}")
    named = joints_in(columns, known or (), several=len(tables) > 1)
    # What names joints of the model is of these, whatever rides below them.
    parts = [] if known and named else drive(columns, clocks.main, vehicle=known is None)
    used = {column for part in parts for column in part.columns}
    left = [c for c in columns if c not in used]
    proposals = _proposals(left, named, known or (), driven=bool(parts), several=len(tables) > 1)
    groups = _groups(proposals, named, several=len(tables) > 1)
    groups, renamed = with_common_labels(groups)
    channels = {name: _channel(group, clocks) for name, group in groups.items()}
    alike = {name: _alike(group) for name, group in groups.items()}
    notes = doubts.of_joints(channels, groups) if not parts else []
    parted = {name: _channel(alike[name], clocks) for name in groups}
    sizes = Sizes(parted, {name: [p.column for p in group] for name, group in alike.items()}, clocks.main)
    sizes.settle()
    channels = {name: _with_others(part, channels[name], groups[name]) for name, part in parted.items()}
    columns_of = {name: [p.column for p in group] for name, group in groups.items()}
    more = _with_vehicle(channels, parts, clocks) if parts else _with_base(channels, columns_of, clocks)
    more += doubts.put_aside(channels, columns_of, driven=bool(parts))
    more += autopilots.notes(columns, tuple(used))
    more += ridden(columns, clocks.main) if known == () and not parts else []
    return ChannelMap(channels=channels, time=clocks.main, notes=(*clocks.notes, *renamed, *notes, *sizes.notes, *more))


def _columns(tables: Sequence[Table], clocks: Clocks, known: Sequence[str]) -> list[Column]:
    """The columns with numbers, without clocks and without those that only number the rows."""
    plain = in_context([name for table in tables for name in table.columns], known)
    read_as = autopilots.read_as(tables, plain)
    return [
        Column(
            table, name, read_as[table.name, name], clocks.clock_of(table, name), table.name if len(tables) > 1 else ""
        )
        for table in tables
        for name, values in table.columns.items()
        if name not in clocks.columns.get(table.name, ())
        and np.any(np.isfinite(values))
        and not ("seq" in (plain := words(name)) and _COUNTERS.issuperset(plain))
        and not _counts_rows(name, values)
    ]


def _counts_rows(name: str, values: Array) -> bool:
    """Whether a column that is called so, or has no name, only numbers the rows, as pandas writes it."""
    unnamed = name.startswith("column_") or set(words(name)) <= _OF_ROWS
    if not unnamed or values.ndim != 1 or len(values) < 2 or values[0] not in (0.0, 1.0):
        return False
    return bool(np.all(np.diff(values) == 1.0))


def _proposals(
    columns: Sequence[Column], named: Mapping[Column, Named], known: Sequence[str], *, driven: bool, several: bool
) -> list[Proposal]:
    """What each column is taken for; in the log of a vehicle nothing is a joint's position, speed or command."""
    proposals = [_proposal(column, named.get(column), several, known) for column in columns]
    if driven:
        return [unchanged(p.column) if p.role.split("_")[0] in _OF_VEHICLES else p for p in proposals]
    proposals = without_other_lists(autopilots.without_guided(proposals, columns))
    proposals = without_places(without_sensors(without_doubles(without_other_signals(proposals, named))))
    return with_twins(proposals, known)


def _proposal(column: Column, named: Named | None, several: bool, known: Sequence[str]) -> Proposal:
    """What a column's name and its file's say of a joint. That a file is a camera's says nothing against one of `known`."""
    reading = joints.read(column.parts if named is None else named.read_as)
    context = joints.read(taken_apart(stem(column.table.name))) if several else None
    plain = column.parts.words
    told = reading.label in known and reading.label not in AXES
    if (
        not reading.joint
        or (context is not None and not context.joint and not told)
        or (named is None and of_base(column))
    ):
        return unchanged(column)
    kind, command, sent = reading.kind, reading.command, reading.sent
    if kind == "torque" and not command and (reading.unit or column.declared) in joints.SHARES.values():
        kind = "load"  # of what a drive is rated for, which nothing here knows in N m
    if kind == "duty" and command and are_pulses(column.known) and np.ptp(column.known) > 0.0:
        kind = "position"  # of a servo that is told by the length of a pulse, and no limit that is set once
    if context is not None:
        kind, sent = kind or context.kind, sent or context.sent
        command = command or (context.command and not context.measured)
    listed = column.values.ndim == 2 or ("observation" in plain and plain[-1].isdigit())
    if not kind and not command and listed and "state" in plain:
        kind = "position"  # LeRobot's observation.state, also one number a column
    role = kind
    if command and kind not in joints.SETTINGS:
        base = "command_sent" if sent else "command"
        role = base if kind in ("", "position") else f"{base}_{kind}"
    if not role:
        return unchanged(column)
    # Voltages and temperatures are more often of the supply than of a joint, and one gain is that of all.
    of_all = kind in ("voltage", "temperature", *joints.SETTINGS) and not reading.label
    label = kind if of_all else joints.label_of(reading.label)
    unit = reading.unit or column.declared
    if role in ("command", "command_sent") and unit in joints.SHARES.values():
        unit = ""  # shares stay as they are: of what, is told by how joints follow them
    return Proposal(column, role, label if named is None else named.joint, unit)


def _own_name(column: Column) -> str:
    """The channel of a column under its own name."""
    plain = own_words(column)
    head = [word for word in plain if word not in axes(plain)]
    prefix = "_".join(words(stem(column.file))) + "_" if column.file else ""
    return prefix + ("_".join(head or plain) or column.name)


def _groups(
    proposals: Sequence[Proposal], named: Mapping[Column, Named], *, several: bool
) -> dict[str, list[Proposal]]:
    """Columns by channel. A second family for a role already taken gets a name of its own."""
    families: dict[tuple[str, str, str, str, bool, bool], list[Proposal]] = {}
    for p in proposals:
        column, family = p.column, family_of(p, proposals, named)
        key = (p.role or _own_name(column), column.table.name, column.clock, family, column.values.ndim > 1, not p.role)
        families.setdefault(key, []).append(p)
    groups: dict[str, list[Proposal]] = {}
    for (role, table, _, family, _, _), members in sorted(
        families.items(), key=lambda f: (f[0][-1], *_rank(f[0][3], f[1]))
    ):
        name = role
        if name in groups:
            first = groups[role][0].column.table.name
            extra = stem(table) if several and table != first else family or members[0].column.name
            name = "_".join([role, *words(extra)])
        while name in groups:
            name += "_2"
        groups[name] = distinct(members)
    return dict(sorted(groups.items(), key=lambda group: _order(group[0])))


def _rank(family: str, members: Sequence[Proposal]) -> tuple[bool, int, bool]:
    """Which family has a role's own name, the least first: what is no variant of another signal, what has most numbers."""
    return family in joints.VARIANTS, -_weight(members), bool(family)


def _weight(members: Sequence[Proposal]) -> int:
    return sum(member.column.width for member in members)


def _channel(group: Sequence[Proposal], clocks: Clocks) -> ChannelColumns:
    first = group[0].column
    width = clocks.widths.get(first.table.name, 0)
    units = {member.unit for member in group}
    return ChannelColumns(
        columns=tuple(member.column.name for member in group),
        file=first.file,
        labels=_labels(group, width),
        width=width,
        unit=group[0].unit if len(units) == 1 else "",
        **clocks.keys_of(first.table, first.clock),
    )


def _alike(group: Sequence[Proposal]) -> list[Proposal]:
    """The columns of a channel of whose unit nothing is said; where all have one, those that have the first's."""
    units = [member.unit for member in group]
    wanted = "" if "" in units else units[0]
    return [member for member in group if member.unit == wanted]


def _with_others(part: ChannelColumns, whole: ChannelColumns, group: Sequence[Proposal]) -> ChannelColumns:
    """A channel of columns in different units (hinges in degrees beside a slide in mm): each has the unit of its name, and
    those without one what `part`, the channel of these alone, was found to have.
    """
    each = [member.unit for member in group for _ in range(member.column.width)]
    if len(set(each)) == 1:
        return part
    units, open_ = tuple(unit or part.unit for unit in each), "" in each
    scale, offset = (tuple(found[0] if not unit else none for unit in each) if open_ and found != (none,) else (none,)
                     for found, none in ((part.scale, 1.0), (part.offset, 0.0)))  # fmt: skip
    if len(set(units)) == 1:
        return replace(whole, unit=units[0], scale=scale, offset=offset)
    return replace(whole, units=units, scale=scale, offset=offset)


def _labels(group: Sequence[Proposal], width: int) -> tuple[str, ...]:
    if width > 1:
        return tuple(f"joint_{i + 1}" for i in range(width))
    total, first = _weight(group), group[0].column
    of_sensor = () if group[0].role else sensor_labels([member.column for member in group])
    if of_sensor:
        return of_sensor
    if all(member.column.width == 1 for member in group):
        labels, known = tuple(member.label for member in group), first.table.labels
        counted = [tuple(f"joint_{k + start}" for k in range(total)) for start in (0, 1)]
        return known if len(known) == total and labels in counted else labels
    if len(group) == 1 and first.name in first.table.named:
        return joints.joint_labels(first.table.named[first.name])
    known = first.table.labels
    counted = in_parts(group) if group[0].role else tuple(f"{i + 1}" for i in range(total))  # four feet are no joints
    return known if len(known) == total else counted


def _with_vehicle(channels: dict[str, ChannelColumns], parts: Sequence[Part], clocks: Clocks) -> list[str]:
    """Adds the channels of a vehicle; returns what to say of them."""
    for part in parts:
        plain = _plain(part.columns, part.labels, part.unit, clocks, part.scale)
        channels[part.channel] = replace(plain, units=part.units, offset=part.offset)
    ordered = sorted(channels.items(), key=lambda item: _order(item[0]))
    channels.clear()
    channels.update(ordered)
    return [note for part in parts for note in part.notes]


def _with_base(
    channels: dict[str, ChannelColumns], groups: Mapping[str, Sequence[Column]], clocks: Clocks
) -> list[str]:
    """Puts the channels of a base's pose in place of the groups that they were; returns what to say of them."""
    found = bases.pose(groups)
    for name in found.groups:
        del channels[name]
    for name, base in found.channels.items():
        channels[name] = _plain(base.columns, base.labels, base.unit, clocks)
    return list(found.notes)


def _plain(
    columns: Sequence[Column], labels: tuple[str, ...], unit: str, clocks: Clocks, scale: tuple[float, ...] = (1.0,)
) -> ChannelColumns:
    first, names = columns[0], tuple(column.name for column in columns)
    keys = clocks.keys_of(first.table, first.clock)
    return ChannelColumns(columns=names, file=first.file, labels=labels, unit=unit, scale=scale, **keys)


def _order(name: str) -> tuple[int, str]:
    """Commands first, then what was measured, then the rest."""
    usual = ("position", "velocity", "acceleration", "torque", "current")
    if is_command(name):
        return (0, name)
    return (1 + usual.index(name), name) if name in usual else (10, name)
