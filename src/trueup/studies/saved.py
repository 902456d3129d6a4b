# SPDX-License-Identifier: Apache-2.0
"""What a study has computed already, in the folder of its results: one that was stopped goes on from there."""

from __future__ import annotations

import fcntl
import json
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from trueup.errors import OutputError
from trueup.formats.aside import write_aside

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_SCALE = "scale.json"


@dataclass(frozen=True)
class Parts:
    """A folder that holds one study in named parts."""

    folder: Path

    @classmethod
    def at(cls, folder: Path, scale: DataclassInstance) -> Self:
        """The parts of a study of this size in `folder`. Raises OutputError where another, or something else, is in it."""
        wanted, parts = json.dumps(asdict(scale), indent=1), folder / "parts"
        if folder.exists() and any(folder.iterdir()) and not (parts / _SCALE).exists():
            raise OutputError(f"'{folder}' holds something else; choose another folder with --out")
        if (parts / _SCALE).exists() and (parts / _SCALE).read_text(encoding="utf-8") != wanted:
            raise OutputError(f"'{folder}' holds a study of another size or seed; choose another folder with --out")
        parts.mkdir(parents=True, exist_ok=True)
        (parts / _SCALE).write_text(wanted, encoding="utf-8")
        return cls(parts)

    def has(self, name: str) -> bool:
        """Whether a part is there."""
        return self.path(name, "npz").exists() or self.path(name, "json").exists()

    def text(self, name: str, compute: Callable[[], object]) -> Any:
        """What is kept under a name, or computed now: anything that JSON holds."""
        path = self.path(name, "json")
        if not path.exists():
            words = json.dumps(compute())
            write_aside(words, path)
        return json.loads(path.read_text(encoding="utf-8"))

    @contextmanager
    def claimed(self, name: str, *, wait: bool = False) -> Iterator[bool]:
        """Whether a part is this process's to compute: several may work in one folder. With `wait`, once it is."""
        with self.path(name, "lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            except BlockingIOError:
                yield False
                return
            yield True

    def path(self, name: str, kind: str) -> Path:
        """The file of a part."""
        return self.folder / f"{re.sub(r'[^A-Za-z0-9]+', '-', name)}.{kind}"
