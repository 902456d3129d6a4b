# SPDX-License-Identifier: Apache-2.0
"""Which columns of files become which channels of a recording, as a commented TOML file that one reads and edits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, get_args

from trueup import files
from trueup.errors import MappingError
from trueup.formats import keys
from trueup.formats.aside import write_aside
from trueup.formats.keys import key
from trueup.typed_toml import build

Repair = Literal["", "sort", "drop", "continue"]

_TITLE = """\
# How the columns of your files become channels. Edit what is wrong, then pass it on: --mapping FILE
# Units are those of the numbers in the file (rad, deg, rev, rad/s, deg/s, rpm, N m, A, mA, m, mm, V, ...);
# everything is converted to SI. Keys that may be added to a channel:
#   file = "state.csv"         the file or topic, where there are several
#   labels = ["hip", "knee"]   one for each column, or for each number of a list
#   units = ["m/s", "deg"]     one for each label, in place of unit
#   scale = 0.00153            or one for each label; likewise offset = 0.0 and sign = -1
#                              value = sign * (number * scale + offset), in unit
#   width = 7                  a file with one number a line, 7 lines a sample
#   time = "t2"                a second clock; with time_unit, and time_offset = seconds or "rows"
#   rate = 1000.0              samples per second, where no column holds time
"""
_NO_TIME = "# rate = 1000.0  # Hz: no column of time was found; say how often samples were taken"
_NO_REPAIR = (
    '# repair = "sort"  # or "drop": rows that go back in time or repeat it; "continue": a clock that was set back'
)


def _repair(value: Any, where: str) -> Repair:
    if value not in get_args(Repair):
        choices = ", ".join(f"'{choice}'" for choice in get_args(Repair) if choice)
        raise MappingError(f"{where}: '{value}' is unknown; choices are: {choices}")
    return value


def _signs(value: Any, where: str) -> tuple[float, ...]:
    signs = keys.numbers(value, where)
    if any(sign not in (1.0, -1.0) for sign in signs):
        raise MappingError(
            f"{where.rpartition(', ')[0]}: sign is {list(signs)}; each must be 1 or -1 (use scale for other factors)"
        )
    return signs


def _columns(value: Any, where: str) -> tuple[str, ...]:
    columns = keys.texts(value, where)
    if not columns:
        raise MappingError(f"{where.rpartition(', ')[0]}: 'columns' is empty; name the columns that hold this channel")
    return columns


def _offset(value: Any, where: str) -> float | Literal["rows"]:
    return "rows" if value == "rows" else keys.number(value, where)


@dataclass(frozen=True)
class TimeColumn:
    """Where the time of the samples is: a column, or a constant rate."""

    file: str = key("", keys.text, comment="holds the time of all files")
    """The file that holds the time of all others; '' means that each has its own column of that name."""
    column: str = key("", keys.text)
    """Name of the column that holds time; '' where there is none and `rate` counts."""
    nanoseconds: str = key("", keys.text, comment="added to the seconds")
    """A second column to add, for clocks written as seconds and nanoseconds."""
    rate: float | None = key(None, keys.rate, comment="Hz")
    """Samples per second, in Hz, where no column holds time."""
    unit: str = key("", keys.time_unit)
    """s, ms, us, ns or min; '' lets name and size of the numbers decide."""
    repair: Repair = key("", _repair, unset=_NO_REPAIR)  # noqa: RUF009 - a field
    """'sort' orders the rows by time, 'drop' leaves out the rows that go back; both drop repeated times. 'continue' takes
    rows as they stand, and a clock that was set back on from there by its usual step."""

    def __post_init__(self) -> None:
        """Raises ValueError where two things say when samples were taken."""
        if self.column and self.rate is not None:
            raise ValueError("both column and rate are given; keep one of them")


@dataclass(frozen=True)
class ChannelColumns:
    """The columns of one channel: value = sign * (number * scale + offset), in `unit`, then converted to SI."""

    columns: tuple[str, ...] = field(metadata={"read": _columns, "comment": "", "unset": ""})
    """Names, patterns with * and ?, or one column whose cells are lists."""
    file: str = key("", keys.text)
    """File name or topic (* and ? allowed), where there are several."""
    labels: tuple[str, ...] = key((), keys.texts)
    """One for each number of a sample, usually joints; () takes them from the names of the columns."""
    unit: str = key("", keys.unit, unset='unit = ""  # unknown')
    """Unit of the numbers in the file, after scale and offset."""
    units: tuple[str, ...] = key((), keys.units)
    """One for each label in place of `unit`, where they differ (speed and steering of a car)."""
    scale: tuple[float, ...] = key((1.0,), keys.numbers)
    """One for all, or one for each label."""
    offset: tuple[float, ...] = key((0.0,), keys.numbers)
    sign: tuple[float, ...] = key((1.0,), _signs)
    width: int = key(0, keys.count, comment="one number a line")
    """Numbers per sample where a file has one number a line; 0 means that each line is a sample."""
    time: str = key("", keys.text, comment="its own clock")
    """A time column of this channel's own, for a second clock."""
    time_unit: str = key("", keys.time_unit)
    time_offset: float | Literal["rows"] = key(
        0.0, _offset, comment='s, added to the time; "rows": what stands in one row was written at one moment'
    )
    """Added to that time, in s; "rows" estimates it, taking what stands in one row as written at one moment."""
    rate: float | None = key(None, keys.rate, comment="Hz")
    """Samples per second, in Hz, where this channel has no time column and not the rate of [time]."""


@dataclass(frozen=True)
class _MappingFile:
    channels: Mapping[str, ChannelColumns] = field(default_factory=dict)
    time: TimeColumn = field(default_factory=TimeColumn)
    joints: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class ChannelMap:
    """How the columns of files become the channels of a recording."""

    channels: Mapping[str, ChannelColumns]
    """By role: command, command_sent, position, velocity, torque, current, or any other name."""
    time: TimeColumn = field(default_factory=TimeColumn)
    joints: Mapping[str, str] = field(default_factory=dict)
    """Labels renamed: as in the file -> as in the model."""
    notes: tuple[str, ...] = ()
    """What a guess was not sure of; written as comments."""

    def __post_init__(self) -> None:
        """Freezes the mappings."""
        object.__setattr__(self, "channels", MappingProxyType(dict(self.channels)))
        object.__setattr__(self, "joints", MappingProxyType(dict(self.joints)))

    @staticmethod
    def load(path: str | Path) -> ChannelMap:
        """The mapping in a TOML file. Raises MappingError, naming the key, for what is unknown or of the wrong kind."""
        return ChannelMap.from_dict(files.toml(Path(path), MappingError), str(path))

    @staticmethod
    def from_dict(data: Mapping[str, Any], where: str = "mapping") -> ChannelMap:
        """The mapping in nested dicts, as TOML gives them. Raises MappingError for unknown keys and wrong kinds."""
        given = build(_MappingFile, data, where, MappingError)
        if not given.channels:
            raise MappingError(f'{where}: no channel is named; add [channels.position] with columns = ["..."]')
        return ChannelMap(given.channels, given.time, given.joints)

    def to_toml(self) -> str:
        """The mapping as commented TOML, for a user to edit; `load` reads it back."""
        lines = [_TITLE, *(f"# note: {_one_line(note)}" for note in self.notes), *([""] if self.notes else [])]
        untimed = not (self.time.column or self.time.file) and self.time.rate is None
        lines += ["[time]", *([_NO_TIME] if untimed else []), *keys.to_lines(self.time)]
        for name, channel in self.channels.items():
            lines += ["", f"[channels.{keys.name(name)}]", *keys.to_lines(channel)]
        lines += ["", "# As in the file = as in the model:"]
        lines += ["[joints]"] if self.joints else ["# [joints]", '# Rotation = "shoulder_pan"']
        lines += [f"{keys.name(old)} = {keys.quoted(new)}" for old, new in self.joints.items()]
        return "\n".join(lines) + "\n"

    def save(self, path: str | Path) -> None:
        """Writes the mapping as commented TOML. Raises OutputError where that fails."""
        write_aside(self.to_toml(), Path(path))


def _one_line(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text)
