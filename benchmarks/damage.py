# SPDX-License-Identifier: Apache-2.0
"""Ways in which files come damaged: cut, flipped, misspelt, mistyped, swapped, absurdly large, or no files at all."""

from __future__ import annotations

import json
import os
import re
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

Rng = np.random.Generator
Damage = Callable[[Rng, bytes], bytes]

_PLAIN = (
    "nan inf -inf 1e300 -1e300 1e999 5e-324 abc [ ] [1,2 # , ; - é 1,5 {} null true 2024-01-01 12:30:05 0x1F 1_0 [[[ "
    "\\ud800 [1,2,3] { ' = <a> --> 9999999999999999999999 ../.. /dev/zero %s {0} *"
)
WORDS = _PLAIN.split()
WORDS += ["", '"', "\0", "\n", "\t", "9" * 400, "[" * 2000, "\x1b[2J\x1b]0;owned\x07", "\u202e\u2066名前", "a" * 5000]
NUMBERS = ("nan", "inf", "-inf", "1e300", "-1e300", "1e-300", "0", "-1", "1e999", "9" * 30, "true")
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 3.5, 1e300, -1e300, 1e-300, float("nan"), float("inf"), 10**30, "", "abc", "*", "\x1b[31m",
    "名前", "../..", "/dev/zero", [], [1], ["a", 1], [[1, 2], [3]], {}, {"type": "x"}, {"a": {"b": [1]}},
)  # fmt: skip


def one_of(rng: Rng, choices: Sequence[Any]) -> Any:
    """One of some choices, whatever they are."""
    return choices[int(rng.integers(len(choices)))]


def cut(rng: Rng, data: bytes) -> bytes:
    """Ends somewhere."""
    return data[: int(rng.integers(len(data) + 1))]


def flip(rng: Rng, data: bytes) -> bytes:
    """One to four bits differ."""
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 5)) if data else 0):
        changed[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def zero(rng: Rng, data: bytes) -> bytes:
    """A stretch of NUL bytes, as a power cut leaves it."""
    at, length = int(rng.integers(len(data) + 1)), int(rng.integers(1, 200))
    return data[:at] + bytes(min(length, len(data) - at)) + data[at + length :]


def insert(rng: Rng, data: bytes) -> bytes:
    """Something strange in the middle."""
    at = int(rng.integers(len(data) + 1))
    return data[:at] + str(one_of(rng, WORDS)).encode("utf-8", "replace") + data[at:]


def delete(rng: Rng, data: bytes) -> bytes:
    """A stretch is missing."""
    at = int(rng.integers(len(data) + 1))
    return data[:at] + data[at + int(rng.integers(1, 200)) :]


def lines(rng: Rng, data: bytes) -> bytes:
    """Lines missing, twice, exchanged, or all but a few gone."""
    rows = data.split(b"\n")
    i, k = (int(rng.integers(len(rows))) for _ in range(2))
    kind = int(rng.integers(5))
    if kind == 0:
        del rows[i]
    elif kind == 1:
        rows.insert(k, rows[i])
    elif kind == 2:
        rows[i], rows[k] = rows[k], rows[i]
    else:
        rows = rows[: int(rng.integers(4))]
    return b"\n".join(rows)


def encoding(rng: Rng, data: bytes) -> bytes:
    """The same text in another encoding, with another end of line, or with what editors put in front."""
    text = data.decode("utf-8", "replace")
    return one_of(rng, (
        text.encode("utf-16"), text.encode("utf-16-le"), text.encode("utf-32"), text.replace("\n", "\r\n").encode(),
        text.replace("\n", "\r").encode(), b"\xef\xbb\xbf" + data, data.replace(b"e", b"\xe9"), data + b"\x1a",
        text.replace(" ", "\u00a0").replace(",", "\uff0c").encode(), data[::-1], b"PK\x03\x04" + data, b"",
    ))  # fmt: skip


def number(rng: Rng, data: bytes) -> bytes:
    """One to three of its numbers are others."""
    for _ in range(int(rng.integers(1, 4))):
        found = list(re.finditer(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?", data[: 1 << 16]))
        if found:
            at = one_of(rng, found)
            data = data[: at.start()] + one_of(rng, NUMBERS).encode() + data[at.end() :]
    return data


def digit(rng: Rng, data: bytes) -> bytes:
    """One digit is another one."""
    at = [i for i, c in enumerate(data) if 48 <= c < 58]
    if not at:
        return data
    i = one_of(rng, at)
    return data[:i] + str((data[i] - 48 + int(rng.integers(1, 10))) % 10).encode() + data[i + 1 :]


def word(rng: Rng, data: bytes) -> bytes:
    """A name, number or quoted text is another one, in all its places or one."""
    found = list(re.finditer(rb"[\w.-]+", data[: 1 << 16]))
    if not found:
        return data
    at = one_of(rng, found)
    other = str(one_of(rng, WORDS)).encode("utf-8", "replace")
    return data.replace(at[0], other) if rng.random() < 0.3 else data[: at.start()] + other + data[at.end() :]


def toml(rng: Rng, data: bytes) -> bytes:
    """A value of another type, a key missing, unknown or with another table's name, lists too long."""
    try:
        tree = tomllib.loads(data.decode())
    except (UnicodeDecodeError, tomllib.TOMLDecodeError):
        return data
    for _ in range(int(rng.integers(1, 3))):
        _altered(rng, tree)
    return "\n".join(f"{json.dumps(str(k))} = {_toml(v)}" for k, v in tree.items() if v is not None).encode(
        "utf-8", "replace"
    )


def jsons(rng: Rng, data: bytes) -> bytes:
    """The same for JSON, or for one of its lines."""
    rows = [data] if data[:1] != b"{" or b"\n{" not in data else data.split(b"\n")
    i = int(rng.integers(len(rows)))
    try:
        tree = json.loads(rows[i])
        _altered(rng, tree)
        rows[i] = json.dumps(tree).encode()
    except (ValueError, RecursionError):
        pass
    return b"\n".join(rows)


def _altered(rng: Rng, tree: Any) -> None:
    """Changes one place somewhere in nested tables and lists."""
    places = (
        [(tree, key) for key in (tree if isinstance(tree, dict) else range(len(tree)))]
        if isinstance(tree, dict | list)
        else []
    )
    for holder, key in places:
        below = holder[key]
        if isinstance(below, dict | list):
            places += [(below, k) for k in (below if isinstance(below, dict) else range(len(below)))]
        if len(places) > 5000:
            break
    if not places:
        return
    holder, key = one_of(rng, places)
    kind = int(rng.integers(6))
    if kind == 0 and isinstance(holder, dict):
        del holder[key]
    elif kind == 1 and isinstance(holder, dict):
        holder[str(one_of(rng, WORDS))] = holder[key]
    elif kind == 2 and isinstance(holder[key], list):
        holder[key] = holder[key] * int(one_of(rng, (2, 50)))
    else:
        holder[key] = one_of(rng, VALUES)


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(str(k))} = {_toml(v)}" for k, v in value.items() if v is not None) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(v) for v in value if v is not None) + "]"
    return json.dumps(str(value)).replace("\\ud800", "?")


def xml(rng: Rng, data: bytes) -> bytes:
    """An attribute with another value, gone or twice; an element gone, twice, or with another name."""
    kind = int(rng.integers(6))
    attributes = list(re.finditer(rb'([\w:]+)="([^"]*)"', data))
    elements = list(re.finditer(rb"<[\w]+[^<>]*/>", data))
    if kind < 4 and attributes:
        at = one_of(rng, attributes)
        values = (*NUMBERS, *WORDS[-10:], "", "0 0 0", "1 2", "a b c", "link", "hinge", "free", "-5 5 5 5 5 5 5 5")
        new = at[1] + b'="' + one_of(rng, values).replace('"', "").replace("\0", "").encode("utf-8", "replace") + b'"'
        return data[: at.start()] + (b"" if kind == 0 else new) + data[at.end() :]
    if elements:
        at = one_of(rng, elements)
        new = (
            at[0] * int(rng.integers(0, 4))
            if kind == 4
            else at[0].replace(b"<", b"<" + one_of(rng, (b"x", b"body", b"geom ", b"include ")))
        )
        return data[: at.start()] + new + data[at.end() :]
    return data


def table(rng: Rng, data: bytes, separator: bytes = b",") -> bytes:
    """Columns exchanged, missing, doubled, empty, renamed, in another unit; rows few; times that stand, run back or jump."""
    rows = [line.split(separator) for line in data.strip().split(b"\n")]
    head, body = rows[0], rows[1:]
    n = len(head)
    i, k = (int(rng.integers(n)) for _ in range(2))
    kind = int(rng.integers(12))
    if kind == 0:
        for row in rows:
            row[i], row[k] = row[k], row[i]
    elif kind == 1:
        rows = [row[:i] + row[i + 1 :] for row in rows]
    elif kind == 2:
        head[i] = head[k]
    elif kind == 3:
        head[i] = str(one_of(rng, WORDS)).replace("\n", " ").encode("utf-8", "replace")
    elif kind == 4:
        fill = one_of(rng, (b"", b"nan", b"inf", b"1e300", b"0", b"abc", b"-1e-300"))
        for row in body:
            row[i] = fill
    elif kind == 5:
        rows = [head, *body[: int(rng.integers(4))]]
    elif kind == 6:
        factor = one_of(rng, (1e-300, 1e300, 1e9, 1e-9, 0.0, -1.0, 1e15))
        for row in body:
            row[i] = repr(float(row[i]) * factor).encode()
    elif kind == 7:
        step = one_of(rng, (1e-300, 1e300, 1e-12, 1e12, 0.0, -0.01))
        for j, row in enumerate(body):
            row[0] = repr(j * step).encode()
    elif kind == 8:
        for j in rng.integers(len(body), size=int(rng.integers(1, 20))):
            body[int(j)][i] = one_of(rng, NUMBERS).encode()
    elif kind == 9:
        rng.shuffle(body)
        rows = [head, *body]
    elif kind == 10 and rng.random() < 0.2:
        rows = [[*row, *(row[-1:] * 10_000)] for row in rows[:4]]
        rows[0] = [*head, *(b"extra_%d" % j for j in range(10_000))]
    else:
        rows = [head, *(row for row in body for _ in range(int(rng.integers(1, 3))))]
    return b"\n".join(separator.join(row) for row in rows) + b"\n"


TEXT: tuple[Damage, ...] = (cut, flip, zero, insert, delete, lines, encoding, number, word)
BINARY: tuple[Damage, ...] = (cut, flip, flip, zero, insert, delete)


def instead(rng: Rng, path: Path) -> None:
    """Puts something in a file's place that is none: a pipe, a device, a folder, or a link to these or to itself."""
    path.unlink()
    kind, aside = int(rng.integers(7)), path.with_name("elsewhere")
    if kind == 0:
        os.mkfifo(path)
    elif kind == 1:
        os.mkfifo(aside)
        path.symlink_to(aside)
    elif kind == 2:
        path.symlink_to(one_of(rng, ("/dev/zero", "/dev/full", "/dev/random", "/dev/tty")))
    elif kind == 3:
        path.mkdir()
    elif kind == 4:
        path.symlink_to(path.name)
    elif kind == 5:
        path.symlink_to("nowhere")
    else:
        path.symlink_to("/proc/self/mem")
