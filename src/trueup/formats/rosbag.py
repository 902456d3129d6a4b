# SPDX-License-Identifier: Apache-2.0
"""Reads ROS 2 bags (sqlite3 and MCAP, and ROS 1 .bag files) without ROS: one table a topic."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.errors import FormatError, MissingExtraError
from trueup.formats import frames
from trueup.formats.messages import Rows, rows_of, stamp_of
from trueup.formats.planned import KIND, Plan, followed, plan_of
from trueup.formats.table import Table, numbers, shown
from trueup.units import to_si

_UNDER_WAY = 1.0  # s; AMCL dates its transforms up to so far ahead
_JOINT_STATE_UNITS = {"position": "rad", "velocity": "rad/s", "effort": "N m"}


@dataclass
class _Topic:
    """Rows collected from the messages of one topic that name the same joints."""

    name: str
    kind: str
    joints: tuple[str, ...]
    stamps: list[float] = field(default_factory=list)
    received: list[float] = field(default_factory=list)
    cells: dict[str, list[float | None]] = field(default_factory=dict)

    def add(self, received: float, rows: Rows) -> None:
        for stamp, values in rows.samples:
            count = len(self.stamps)
            self.stamps.append(received if stamp is None else stamp)
            self.received.append(received)
            for name, value in values.items():
                column = self.cells.setdefault(name, [])
                column.extend([None] * (count - len(column)))
                column.append(value)


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: a folder with metadata.yaml, or a file that ends in .mcap, .db3 or .bag."""
    return (path / "metadata.yaml").is_file() or path.suffix.lower() in (".mcap", ".db3", ".bag")


def read(path: Path) -> list[Table]:
    """One table for each topic that holds numbers.

    Its columns are the numeric fields ("position/elbow" where the message names joints), 'stamp' (the header's time,
    or that of reception where there is none) and 'received', both in s. Raises MissingExtraError if `rosbags` is not
    installed, and FormatError for an unreadable bag.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise MissingExtraError("reading ROS bags", "rosbags", "ros") from None
    topics: dict[tuple[str, frozenset[str]], _Topic] = {}
    plans: dict[tuple[str, frozenset[str]], list[Plan]] = {}
    links: frames.Links = {}
    warnings: dict[str, int] = {}
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            for topic, kind, received, message in _messages(reader, warnings):
                if kind.endswith(KIND):
                    plan = plan_of(message, received, stamp_of(message))
                    if plan is not None:
                        plans.setdefault((topic, frozenset(plan.joints)), []).append(plan)
                    continue
                if kind.lower().endswith(frames.KIND):
                    frames.take(message, received, links)
                    continue
                rows = rows_of(message, kind)
                if rows.samples:
                    key = (topic, frozenset(rows.joints))
                    topics.setdefault(key, _Topic(topic, kind, rows.joints)).add(received, rows)
    except FormatError:
        raise
    except Exception as error:  # a damaged bag raises errors of sqlite, of the compression, of the parser, ...
        reason = " ".join(str(error).split())[:300] or type(error).__name__
        raise FormatError(f"{path}: cannot be read as a bag ({reason})") from error
    notes = tuple(f"{path.name}: {reason} ({count} messages)" for reason, count in list(warnings.items())[:20])
    commanded = [_commanded(topic, each, list(topics.values())) for (topic, _), each in plans.items()]
    placed, through = _of_frames(links)
    everything = [*topics.values(), *commanded, *placed]
    notes += tuple(f"{path.name}: {said}" for said in (*through, *_one_clock(everything)))
    tables = _tables(everything, path, notes)
    if not tables:
        raise FormatError(f"{path}: no message with numbers in this bag" + (f"; {'; '.join(notes)}" if notes else ""))
    return tables


def _messages(reader: Any, warnings: dict[str, int]) -> Iterator[tuple[str, str, float, Any]]:
    """Topic, type, time of reception [s] and content of each message that can be decoded."""
    for connection, received, raw in reader.messages():
        try:
            message = reader.deserialize(raw, connection.msgtype)
        except Exception as error:  # an unknown type or a damaged message costs this message only
            reason = f"{connection.topic} ({connection.msgtype}) cannot be decoded: {_cause(error)}"
            warnings[reason] = warnings.get(reason, 0) + 1
            continue
        yield connection.topic, connection.msgtype, received * to_si("ns")[1], message


def _commanded(topic: str, plans: Sequence[Plan], others: Sequence[_Topic]) -> _Topic:
    """What trajectories told the joints, sample by sample; the first starts from where they were measured to be."""
    joints = plans[0].joints
    ordered = [plan.in_order(joints) for plan in plans]
    time, values = followed(ordered, lambda at: _measured(others, joints, at))
    columns = {f"desired.positions/{joint}": column.tolist() for joint, column in zip(joints, values.T, strict=True)}
    return _Topic(topic, f"trajectory_msgs/msg{KIND}", joints, time.tolist(), time.tolist(), columns)


def _of_frames(links: frames.Links) -> tuple[list[_Topic], list[str]]:
    """The base's pose as a topic, where links tell it, and which of them."""
    found = frames.base(links)
    if found is None:
        return [], []
    through, link = found
    said = [f"/tf is taken as {through}, of {len(links)} links"] if len(links) > 1 else []
    return [_Topic("/tf", "tf2_msgs/msg/TFMessage", (), link.stamps, link.received, frames.cells(link))], said


def _one_clock(topics: Sequence[_Topic]) -> list[str]:
    """Sets headers' times of other clocks than the recorder's to its own where topics have several, and says so.

    A message is on its way for less than _UNDER_WAY: what is stamped further off is by the clock of another computer, or of
    a simulation. Topics of one such clock keep their times to one another; the quickest of them tells how far off it is.
    """
    gaps = [float(np.median(np.subtract(topic.received, topic.stamps))) for topic in topics]
    if all(abs(gap - gaps[0]) < _UNDER_WAY for gap in gaps):
        return []
    said: list[str] = []
    left = sorted((gap, k) for k, gap in enumerate(gaps) if abs(gap) >= _UNDER_WAY)
    while left:
        off = left[0][0]
        same = [k for gap, k in left if gap - off < _UNDER_WAY]
        left = left[len(same) :]
        for k in same:
            topics[k].stamps = [stamp + off for stamp in topics[k].stamps]
        names = ", ".join(sorted({topics[k].name for k in same}))
        where = "behind" if off > 0.0 else "ahead of"
        said.append(f"{names}: stamped by a clock that is {abs(off):.6g} s {where} the recorder's, and set to that")
    return said


def _measured(topics: Sequence[_Topic], joints: Sequence[str], at: float) -> Array | None:
    """(k,) where the joints were last before a time, by the first topic that tells; None where none does."""
    for topic in topics:
        columns = [topic.cells.get(f"position/{joint}", []) for joint in joints]
        before = [i for i, stamp in enumerate(topic.stamps) if stamp <= at]
        last = [c[before[-1]] if before and len(c) > before[-1] else None for c in columns]
        found = [value for value in last if value is not None]
        if len(found) == len(joints):
            return np.array(found, dtype=np.float64)
    return None


def _cause(error: Exception) -> str:
    if isinstance(error, KeyError):
        return "the bag does not say how this type is laid out"
    return shown(str(error) or type(error).__name__)


def _tables(topics: Sequence[_Topic], path: Path, notes: tuple[str, ...]) -> list[Table]:
    """Tables; where one topic carries messages of several publishers, each with its joints, their names differ."""
    tables: list[Table] = []
    for topic in sorted(topics, key=lambda t: -len(t.stamps) * len(t.cells)):
        same = sum(table.name.split("#")[0] == topic.name for table in tables)
        name = f"{topic.name}#{same + 1}" if same else topic.name
        table = _table(topic, name, path, () if tables else notes)
        if table is not None:
            tables.append(table)
    return tables


def _table(topic: _Topic, name: str, path: Path, notes: tuple[str, ...]) -> Table | None:
    length = len(topic.stamps)
    columns: dict[str, Array] = {}
    for column, cells in topic.cells.items():
        values = numbers([*cells, *[None] * (length - len(cells))], f"{path}, topic '{name}', '{column}'", "message")
        if not isinstance(values, list):
            columns[column] = values
    if not columns:
        return None
    clock = {"stamp": _array(topic.stamps), "received": _array(topic.received)}
    units = {"stamp": "s", "received": "s"}
    if topic.kind.endswith("/JointState"):
        for column in columns:
            units[column] = _JOINT_STATE_UNITS.get(column.split("/")[0], "")
    return Table(name, f"{path} {name}", {**clock, **columns}, units=units, row_word="message", warnings=notes)


def _array(values: Sequence[float]) -> Array:
    result = numbers(values, "time", "message")
    if isinstance(result, list):
        raise FormatError("time of messages is no number")
    return result
