# SPDX-License-Identifier: Apache-2.0
"""How columns become channels: a typed mapping that reads and writes a commented TOML file."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from trueup.errors import MappingError, TrueupError
from trueup.formats.table import listing
from trueup.units import to_si

Repair = Literal["", "sort", "drop"]


@dataclass(frozen=True)
class TimeColumn:
    """Where the time of the samples is: a column, or a constant rate."""

    column: str = ""
    """Name of the column that holds time; '' where there is none and `rate` counts."""
    nanoseconds: str = ""
    """A second column to add, for clocks written as seconds and nanoseconds."""
    unit: str = ""
    """s, ms, us, ns or min; '' lets name and size of the numbers decide."""
    rate: float | None = None
    """Samples per second, in Hz, where no column holds time."""
    file: str = ""
    """The file that holds the time of all others; '' means that each has its own column of that name."""
    repair: Repair = ""
    """'sort' orders the rows by time, 'drop' leaves out the rows that go back; both drop repeated times."""


@dataclass(frozen=True)
class ChannelColumns:
    """The columns of one channel: value = sign * (number * scale + offset), in `unit`, then converted to SI."""

    columns: tuple[str, ...]
    """Names, patterns with * and ?, or one column whose cells are lists."""
    file: str = ""
    """File name or topic (* and ? allowed), where there are several."""
    labels: tuple[str, ...] = ()
    """One for each number of a sample, usually joints; () takes them from the names of the columns."""
    unit: str = ""
    """Unit of the numbers in the file, after scale and offset."""
    scale: tuple[float, ...] = (1.0,)
    """One for all, or one for each label."""
    offset: tuple[float, ...] = (0.0,)
    sign: tuple[float, ...] = (1.0,)
    width: int = 0
    """Numbers per sample where a file has one number a line; 0 means that each line is a sample."""
    time: str = ""
    """A time column of this channel's own, for a second clock."""
    time_unit: str = ""
    time_offset: float | Literal["rows"] = 0.0
    """Added to that time, in s; "rows" estimates it, taking what stands in one row as written at one moment."""
    rate: float | None = None
    """Samples per second, in Hz, where this channel has no time column and not the rate of [time]."""


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
        try:
            data = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise MappingError(f"{path}: cannot be read ({error.strerror or error})") from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
            raise MappingError(f"{path}: not valid TOML ({error})") from None
        return ChannelMap.from_dict(data, str(path))

    @staticmethod
    def from_dict(data: Mapping[str, Any], where: str = "mapping") -> ChannelMap:
        """The mapping in nested dicts, as TOML gives them. Raises MappingError for unknown keys and wrong kinds."""
        _known(data, ("time", "channels", "joints"), where)
        channels = _section(data.get("channels", {}), f"{where}, [channels]")
        if not channels:
            raise MappingError(f'{where}: no channel is named; add [channels.position] with columns = ["..."]')
        return ChannelMap(
            channels={name: _channel(entry, f"{where}, [channels.{name}]") for name, entry in channels.items()},
            time=_time(data.get("time", {}), f"{where}, [time]"),
            joints={
                old: _text(new, f"{where}, [joints], {old}")
                for old, new in _section(data.get("joints", {}), f"{where}, [joints]").items()
            },
        )

    def to_toml(self) -> str:
        """The mapping as commented TOML, for a user to edit."""
        from trueup.formats.mapping_text import to_toml

        return to_toml(self)

    def save(self, path: str | Path) -> None:
        """Writes the mapping as commented TOML. Raises OutputError where that fails."""
        from trueup.formats.aside import written_aside

        with written_aside(Path(path)) as temporary:
            temporary.write_text(self.to_toml(), encoding="utf-8")


def _channel(entry: Any, where: str) -> ChannelColumns:
    data = _section(entry, where)
    _known(data, [f.name for f in dataclasses.fields(ChannelColumns)], where)
    if "columns" not in data:
        raise MappingError(f"{where}: 'columns' is missing; name the columns that hold this channel")
    result = ChannelColumns(
        columns=_texts(data["columns"], f"{where}, columns"),
        file=_text(data.get("file", ""), f"{where}, file"),
        labels=_texts(data.get("labels", []), f"{where}, labels"),
        unit=_unit(data.get("unit", ""), f"{where}, unit"),
        scale=_numbers(data.get("scale", 1.0), f"{where}, scale"),
        offset=_numbers(data.get("offset", 0.0), f"{where}, offset"),
        sign=_numbers(data.get("sign", 1.0), f"{where}, sign"),
        width=_width(data.get("width", 0), f"{where}, width"),
        time=_text(data.get("time", ""), f"{where}, time"),
        time_unit=_time_unit(data.get("time_unit", ""), f"{where}, time_unit"),
        time_offset=_time_offset(data.get("time_offset", 0.0), f"{where}, time_offset"),
        rate=_rate(data.get("rate"), f"{where}, rate"),
    )
    if not result.columns:
        raise MappingError(f"{where}: 'columns' is empty; name the columns that hold this channel")
    if any(sign not in (1.0, -1.0) for sign in result.sign):
        raise MappingError(f"{where}: sign is {list(result.sign)}; each must be 1 or -1 (use scale for other factors)")
    return result


def _time(entry: Any, where: str) -> TimeColumn:
    data = _section(entry, where)
    _known(data, [f.name for f in dataclasses.fields(TimeColumn)], where)
    result = TimeColumn(
        column=_text(data.get("column", ""), f"{where}, column"),
        nanoseconds=_text(data.get("nanoseconds", ""), f"{where}, nanoseconds"),
        unit=_time_unit(data.get("unit", ""), f"{where}, unit"),
        rate=_rate(data.get("rate"), f"{where}, rate"),
        file=_text(data.get("file", ""), f"{where}, file"),
        repair=_repair(data.get("repair", ""), f"{where}, repair"),
    )
    if result.column and result.rate is not None:
        raise MappingError(f"{where}: both column and rate are given; keep one of them")
    return result


def _known(data: Mapping[str, Any], known: list[str] | tuple[str, ...], where: str) -> None:
    for key in data:
        if key not in known:
            raise MappingError(f"{where}: unknown key '{key}'; keys are: {listing(sorted(known))}")


def _section(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise MappingError(f"{where}: {value!r} is not a table of keys")
    return value


def _text(value: Any, where: str) -> str:
    if not isinstance(value, str):
        raise MappingError(f"{where}: {value!r} is not a text in quotes")
    return value


def _texts(value: Any, where: str) -> tuple[str, ...]:
    entries = [value] if isinstance(value, str) else value
    if not isinstance(entries, (list, tuple)):
        raise MappingError(f"{where}: {value!r} is not a list of texts")
    return tuple(_text(entry, where) for entry in entries)


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < 1e300:
        raise MappingError(f"{where}: {value!r} is not a finite number")
    return float(value)


def _numbers(value: Any, where: str) -> tuple[float, ...]:
    entries = value if isinstance(value, (list, tuple)) else [value]
    if not entries:
        raise MappingError(f"{where}: the list is empty; give one number, or one for each label")
    return tuple(_number(entry, where) for entry in entries)


def _width(value: Any, where: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise MappingError(f"{where}: {value!r} is not a number of columns (1, 2, ...)")
    return value


def _rate(value: Any, where: str) -> float | None:
    if value is None:
        return None
    rate = _number(value, where)
    if rate <= 0.0:
        raise MappingError(f"{where}: {rate:g} Hz is not a positive rate")
    return rate


def _unit(value: Any, where: str) -> str:
    unit = _text(value, where)
    try:
        to_si(unit)
    except TrueupError as error:
        raise MappingError(f"{where}: {error}") from None
    return unit


def _time_unit(value: Any, where: str) -> str:
    unit = _unit(value, where)
    if unit and to_si(unit)[0] != "s":
        raise MappingError(f"{where}: '{unit}' is not a unit of time; give s, ms, us, ns or min")
    return unit


def _time_offset(value: Any, where: str) -> float | Literal["rows"]:
    return "rows" if value == "rows" else _number(value, where)


def _repair(value: Any, where: str) -> Repair:
    if value not in ("", "sort", "drop"):
        raise MappingError(f"{where}: '{value}' is unknown; choices are: 'sort', 'drop'")
    return value
