# SPDX-License-Identifier: Apache-2.0
"""Writes a text so that there is always a whole file."""

from __future__ import annotations

from pathlib import Path

from trueup.formats.aside import written_aside


def write_aside(text: str, path: Path) -> None:
    """Write `text` to `path` as UTF-8; missing folders are made.

    Raises:
        OutputError: the folder or disk does not take it; what was at `path` is untouched.
    """
    with written_aside(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
