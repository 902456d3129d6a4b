# SPDX-License-Identifier: Apache-2.0
"""Reads ROS 2 bags (sqlite3 and MCAP, and ROS 1 .bag files) without ROS: one table a topic."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.errors import FormatError, MissingExtraError
from trueup.formats import frames
from trueup.formats.bag_clocks import Stamps, in_order, shifts
from trueup.formats.messages import Rows, rows_of, stamp_of
from trueup.formats.planned import KIND, Plan, followed, plan_of
from trueup.formats.table import Table, listing, numbers, shown
from trueup.units import size_of

_UNITS = {
    "position": "rad", "velocity": "rad/s", "acceleration": "rad/s^2", "effort": "N m",
    "positions": "rad", "velocities": "rad/s", "accelerations": "rad/s^2",
}  # fmt: skip
"""Of joints in messages of ROS: SI, by REP 103."""
_OF_JOINTS = ("/JointState", "/DynamicJointState", "ControllerState", KIND)


@dataclass
class _Topic:
    """Rows collected from the messages of one topic that name the same joints."""

    name: str
    kind: str
    joints: tuple[str, ...]
    stamps: Stamps = field(default_factory=Stamps)
    cells: dict[str, list[float | None]] = field(default_factory=dict)

    def add(self, received: float, rows: Rows) -> None:
        for stamp, values in rows.samples:
            count = len(self.stamps)
            self.stamps.add(stamp, received)
            for name, value in values.items():
                column = self.cells.setdefault(name, [])
                column.extend([None] * (count - len(column)))
                column.append(value)


@dataclass(frozen=True)
class _Timed:
    """A topic and the instants of its messages (n,), in s."""

    topic: _Topic
    instants: Array


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
                elif (rows := rows_of(message, kind)).samples:
                    key = (topic, frozenset(rows.joints))
                    topics.setdefault(key, _Topic(topic, kind, rows.joints)).add(received, rows)
    except FormatError:
        raise
    except Exception as error:  # a damaged bag raises errors of sqlite, of the compression, of the parser, ...
        reason = " ".join(str(error).split())[:300] or type(error).__name__
        raise FormatError(f"{path}: cannot be read as a bag ({reason}){_cut_off(path)}") from error
    notes = tuple(f"{path.name}: {reason} ({count} messages)" for reason, count in list(warnings.items())[:20])
    placed, through = _of_frames(links)
    everything = [*topics.values(), *placed]
    moved, said = _one_clock(everything, plans)
    measured = [_Timed(topic, topic.stamps.instants(moved.get(topic.name, 0.0))) for topic in everything]
    commanded = [_commanded(topic, each, measured, moved.get(topic, 0.0)) for (topic, _), each in plans.items()]
    notes += tuple(f"{path.name}: {note}" for note in (*through, *said))
    tables = _tables([*measured, *commanded], path, notes)
    if not tables:
        raise FormatError(f"{path}: no message with numbers in this bag" + (f"; {'; '.join(notes)}" if notes else ""))
    return tables


def _cut_off(path: Path) -> str:
    """What to do about an MCAP file that its recorder did not finish: it says at its end where everything is."""
    magic = b"\x89MCAP0\r\n"
    for file in sorted(path.glob("*.mcap")) if path.is_dir() else [path]:
        content = file.read_bytes() if file.suffix.lower() == ".mcap" else b""
        if content.startswith(magic) and not content[len(magic) :].endswith(magic):
            return (
                f": {file.name} ends early, as where the recorder was killed or the disk was full; `mcap recover {file.name} "
                "-o whole.mcap` makes a file of what is in it"
            )
    return ""


def _one_clock(
    topics: Sequence[_Topic], plans: Mapping[tuple[str, frozenset[str]], Sequence[Plan]]
) -> tuple[dict[str, float], list[str]]:
    """See `shifts`: the seconds that headers of each topic are moved by."""
    stamps: dict[str, Stamps] = {}
    for topic in topics:
        joined = stamps.setdefault(topic.name, Stamps())
        for stamped, received in zip(topic.stamps.stamped, topic.stamps.received, strict=True):
            joined.add(stamped, received)
    for (name, _), each in plans.items():
        for plan in each:
            stamps.setdefault(name, Stamps()).add(plan.stamped, plan.received)
    return shifts(stamps)


def _messages(reader: Any, warnings: dict[str, int]) -> Iterator[tuple[str, str, float, Any]]:
    """Topic, type, time of reception [s] and content of each message that can be decoded."""
    for connection, received, raw in reader.messages():
        try:
            message = reader.deserialize(raw, connection.msgtype)
        except Exception as error:  # an unknown type or a damaged message costs this message only
            reason = f"{connection.topic} ({connection.msgtype}) cannot be decoded: {_cause(error)}"
            warnings[reason] = warnings.get(reason, 0) + 1
            continue
        yield connection.topic, connection.msgtype, received * size_of("ns"), message


def _commanded(topic: str, plans: Sequence[Plan], others: Sequence[_Timed], ahead: float) -> _Timed:
    """What trajectories told the joints, sample by sample; the first starts from where they were measured to be."""
    joints = plans[0].joints
    ordered = [plan.in_order(joints).later(ahead) for plan in plans]
    time, values = followed(ordered, lambda at: _measured(others, joints, at))
    columns = {f"desired.positions/{joint}": column.tolist() for joint, column in zip(joints, values.T, strict=True)}
    stamps = Stamps([None] * len(time), time.tolist())
    return _Timed(_Topic(topic, f"trajectory_msgs/msg{KIND}", joints, stamps, columns), time)


def _of_frames(links: frames.Links) -> tuple[list[_Topic], list[str]]:
    """The base's pose as a topic, where links tell it, and which of them."""
    found = frames.base(links)
    if found is None:
        return [], []
    through, link = found
    said = [f"/tf is taken as {through}, of {len(links)} links"] if len(links) > 1 else []
    stamps = Stamps([*link.stamps], link.received)
    return [_Topic("/tf", "tf2_msgs/msg/TFMessage", (), stamps, frames.cells(link))], said


def _measured(topics: Sequence[_Timed], joints: Sequence[str], at: float) -> Array | None:
    """(k,) where the joints were last before a time, by the first topic that tells; None where none does."""
    for timed in topics:
        columns = [timed.topic.cells.get(f"position/{joint}", []) for joint in joints]
        before = np.flatnonzero(timed.instants <= at)
        last = [c[before[-1]] if len(before) and len(c) > before[-1] else None for c in columns]
        found = [value for value in last if value is not None]
        if len(found) == len(joints):
            return np.array(found, dtype=np.float64)
    return None


def _cause(error: Exception) -> str:
    if isinstance(error, KeyError):
        return "the bag does not say how this type is laid out"
    return shown(str(error) or type(error).__name__)


def _tables(topics: Sequence[_Timed], path: Path, notes: tuple[str, ...]) -> list[Table]:
    """Tables; where one topic carries messages of several publishers, each with its joints, their names differ."""
    tables: list[Table] = []
    for timed in sorted(topics, key=lambda t: -len(t.instants) * len(t.topic.cells)):
        same = sum(table.name.split("#")[0] == timed.topic.name for table in tables)
        name = f"{timed.topic.name}#{same + 1}" if same else timed.topic.name
        table = _table(timed, name, path, () if tables else notes)
        if table is not None:
            tables.append(table)
    return tables


def _table(timed: _Timed, name: str, path: Path, notes: tuple[str, ...]) -> Table | None:
    topic, length = timed.topic, len(timed.instants)
    columns: dict[str, Array] = {}
    for column, cells in topic.cells.items():
        values = numbers([*cells, *[None] * (length - len(cells))], f"{path}, topic '{name}', '{column}'", "message")
        if not isinstance(values, list):
            columns[column] = values
    if not columns:
        return None
    nothing = [column for column, values in columns.items() if not np.isfinite(values).any()]
    if nothing:
        notes = (*notes, f"{path.name}: no number in any message of {name}: {listing(nothing)}")
    columns = {"stamp": timed.instants, "received": np.array(topic.stamps.received), **columns}
    if (order := in_order(timed.instants)) is not None:
        columns = {column: values[order] for column, values in columns.items()}
    units = {"stamp": "s", "received": "s"}
    if topic.kind.endswith(_OF_JOINTS):
        for column in list(columns)[2:]:
            units[column] = _UNITS.get(column.split("/")[0].split(".")[-1], "")
    return Table(name, f"{path} {name}", columns, units=units, row_word="message", warnings=notes)
