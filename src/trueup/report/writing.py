# SPDX-License-Identifier: Apache-2.0
"""Writing a file so that there is always a whole one: the new beside the old, then renamed onto it."""

from __future__ import annotations

import os
from pathlib import Path

from trueup.errors import OutputError


def write_aside(text: str, path: Path) -> None:
    """Write `text` to `path` as UTF-8; missing folders are made.

    Raises:
        OutputError: the folder or disk does not take it; what was at `path` is untouched.
    """
    aside = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with aside.open("w", encoding="utf-8", newline="\n") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.replace(aside, path)
    except OSError as error:
        reason = error.strerror or str(error)
        kept = "; the older file there is untouched" if path.is_file() else ""
        raise OutputError(f"cannot write '{path}': {reason}{kept}") from error
    finally:
        _discard(aside)


def _discard(aside: Path) -> None:
    # after a success it is gone already; after a failure a broken disk must not hide the first error
    try:
        aside.unlink(missing_ok=True)
    except OSError:
        return
