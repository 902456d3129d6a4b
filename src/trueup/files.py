# SPDX-License-Identifier: Apache-2.0
"""What a user's files hold, read whole: pipes, devices and folders are refused, behind links too, before anything waits."""

from __future__ import annotations

import difflib
import os
import stat
import tomllib
from pathlib import Path
from typing import Any

from trueup.errors import TrueupError

_KINDS = {
    stat.S_IFIFO: "a pipe", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device", stat.S_IFSOCK: "a socket",
    stat.S_IFDIR: "a folder",
}  # fmt: skip


def check(path: Path, error: type[TrueupError]) -> None:
    """Raises `error` where there is no file of this name, or something else has it: reading that might never end."""
    try:
        kind = stat.S_IFMT(path.stat().st_mode)
    except FileNotFoundError:
        raise error(f"{path}: no such file{hint(path)}") from None
    except (OSError, ValueError) as reason:
        raise error(f"{path}: cannot be read ({getattr(reason, 'strerror', None) or reason})") from None
    if kind != stat.S_IFREG:
        behind = " behind a link" if path.is_symlink() else ""
        raise error(f"{path}: cannot be read, it is {_KINDS.get(kind, 'no file')}{behind}; give a file")


def content(path: Path, error: type[TrueupError]) -> bytes:
    """The bytes of a file. Raises `error`."""
    check(path, error)
    try:
        return path.read_bytes()
    except OSError as reason:
        raise error(f"{path}: cannot be read ({reason.strerror or reason})") from None


def text(path: Path, error: type[TrueupError]) -> str:
    """The text of a file in UTF-8. Raises `error`."""
    try:
        return content(path, error).decode("utf-8-sig")
    except UnicodeDecodeError as reason:
        raise error(f"{path}: is not text in UTF-8 ({reason.reason} at byte {reason.start})") from None


def toml(path: Path, error: type[TrueupError], content: str | None = None) -> dict[str, Any]:
    """The tables of a TOML file, or of `content` that came from it. Raises `error`, with line and column where it is none."""
    try:
        return tomllib.loads((text(path, error) if content is None else content).replace("\r\n", "\n"))
    except (tomllib.TOMLDecodeError, RecursionError) as reason:
        raise error(f"{path}: not valid TOML ({reason})") from None


def hint(path: Path) -> str:
    """The nearest name in the folder of a file that is not there: ' (did you mean ...?)', '' where none is near."""
    try:
        near = difflib.get_close_matches(path.name, os.listdir(path.parent), n=1)
    except (OSError, ValueError):
        near = []
    return f" (did you mean '{path.parent / near[0]}'?)" if near else ""
