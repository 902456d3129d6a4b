# SPDX-License-Identifier: Apache-2.0
"""Writes a mapping as TOML with comments that say what each key means."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence

from trueup.formats.mapping import ChannelColumns, ChannelMap, TimeColumn

_TITLE = """\
# How the columns of your files become channels. Edit what is wrong, then pass it on: --mapping FILE
# Units are those of the numbers in the file (rad, deg, rev, rad/s, deg/s, rpm, N m, A, mA, m, mm, V, ...);
# everything is converted to SI. Keys that may be added to a channel:
#   file = "state.csv"         the file or topic, where there are several
#   labels = ["hip", "knee"]   one for each column, or for each number of a list
#   scale = 0.00153            or one for each label; likewise offset = 0.0 and sign = -1
#                              value = sign * (number * scale + offset), in unit
#   width = 7                  a file with one number a line, 7 lines a sample
#   time = "t2"                a second clock; with time_unit, and time_offset = seconds or "rows"
#   rate = 1000.0              samples per second, where no column holds time
"""


def to_toml(mapping: ChannelMap) -> str:
    """The mapping as a TOML document that `ChannelMap.load` reads back."""
    lines = [_TITLE]
    lines += [f"# note: {_one_line(note)}" for note in mapping.notes]
    lines += ["" if mapping.notes else None, *_time(mapping.time)]
    for name, channel in mapping.channels.items():
        lines += ["", f"[channels.{_key(name)}]", *_channel(channel)]
    lines += ["", "# As in the file = as in the model:"]
    lines += ["[joints]"] if mapping.joints else ["# [joints]", '# Rotation = "shoulder_pan"']
    lines += [f"{_key(old)} = {_quote(new)}" for old, new in mapping.joints.items()]
    return "\n".join(line for line in lines if line is not None) + "\n"


def _time(time: TimeColumn) -> list[str]:
    lines = ["[time]"]
    if time.file:
        lines.append(f"file = {_quote(time.file)}  # holds the time of all files")
    if time.column:
        lines.append(f"column = {_quote(time.column)}")
    if time.nanoseconds:
        lines.append(f"nanoseconds = {_quote(time.nanoseconds)}  # added to the seconds")
    if time.rate is not None:
        lines.append(f"rate = {time.rate!r}  # Hz")
    elif not time.column:
        lines.append("# rate = 1000.0  # Hz: no column of time was found; say how often samples were taken")
    if time.unit:
        lines.append(f"unit = {_quote(time.unit)}")
    if time.repair:
        lines.append(f"repair = {_quote(time.repair)}")
    else:
        lines.append('# repair = "sort"  # or "drop": rows that go back in time or repeat it')
    return lines


def _channel(channel: ChannelColumns) -> list[str]:
    lines = [f"file = {_quote(channel.file)}"] if channel.file else []
    lines.append(f"columns = {_quotes(channel.columns)}")
    if channel.labels:
        lines.append(f"labels = {_quotes(channel.labels)}")
    lines.append(f"unit = {_quote(channel.unit)}" + ("" if channel.unit else "  # unknown"))
    for key, values, usual in (
        ("scale", channel.scale, 1.0),
        ("offset", channel.offset, 0.0),
        ("sign", channel.sign, 1.0),
    ):
        if values != (usual,):
            lines.append(f"{key} = {_numbers(values)}")
    if channel.width:
        lines.append(f"width = {channel.width}  # one number a line")
    if channel.time:
        lines.append(f"time = {_quote(channel.time)}  # its own clock")
    if channel.time_unit:
        lines.append(f"time_unit = {_quote(channel.time_unit)}")
    if channel.time_offset == "rows":
        lines.append('time_offset = "rows"  # estimated: what stands in one row was written at one moment')
    elif channel.time_offset:
        lines.append(f"time_offset = {channel.time_offset!r}  # s, added to the time")
    if channel.rate is not None:
        lines.append(f"rate = {channel.rate!r}  # Hz")
    return lines


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _quote(name)


def _quote(text: str) -> str:
    # JSON escapes are TOML escapes, except that TOML wants DEL escaped and knows no surrogates.
    plain = text.encode("utf-8", "replace").decode("utf-8")
    return json.dumps(plain, ensure_ascii=False).replace("\x7f", "\\u007f")


def _quotes(texts: Sequence[str]) -> str:
    entries = [_quote(text) for text in texts]
    flat = "[" + ", ".join(entries) + "]"
    return flat if len(flat) <= 100 else "[\n    " + ",\n    ".join(entries) + ",\n]"


def _numbers(values: Sequence[float]) -> str:
    return repr(values[0]) if len(values) == 1 else "[" + ", ".join(repr(value) for value in values) + "]"


def _one_line(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text)
