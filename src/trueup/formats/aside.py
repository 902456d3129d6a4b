# SPDX-License-Identifier: Apache-2.0
"""Files written aside and renamed, so that what was there before stays whole until the new one is complete."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from trueup.errors import OutputError


@contextmanager
def written_aside(path: Path) -> Iterator[Path]:
    """A temporary file in the folder of `path` (made if needed), which takes its place at the end.

    Raises OutputError where writing fails; then the temporary file is removed and `path` is as it was.
    """
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise OutputError(f"cannot write '{path}': it is a folder; give the name of a file")
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
        os.close(handle)
        temporary = Path(name)
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.chmod(0o666 & ~_umask())
        os.replace(temporary, path)
        temporary = None
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(f"cannot write '{path}': {reason}; what was there before is untouched") from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def write_aside(content: str | bytes, path: Path) -> None:
    """Writes a text as UTF-8, or bytes, so that there is always a whole file; folders are made. Raises OutputError."""
    with written_aside(path) as temporary:
        temporary.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


def sync_folder(folder: Path) -> None:
    """Makes the names in a folder safe on disk: a rename is, only after this."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def kept_state(path: Path) -> dict[str, Any] | None:
    """The JSON object in a file of our own; None where there is none, or none that can be read (only time is lost)."""
    try:
        state = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return state if isinstance(state, dict) else None


def _umask() -> int:
    """The process's umask; reading it means setting it for a moment."""
    mask = os.umask(0o022)
    os.umask(mask)
    return mask
