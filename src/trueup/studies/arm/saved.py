# SPDX-License-Identifier: Apache-2.0
"""What is computed already, in the folder of the results: a study that was stopped goes on from there."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trueup.errors import OutputError
from trueup.formats.aside import written_aside
from trueup.studies.arm.comparison import Errors, Example, Scale

Array = NDArray[np.float64]

_SCALE = "scale.json"
_SEP = "|"


@dataclass(frozen=True)
class Store:
    """A folder that holds one study: the errors of each condition, and further parts as JSON."""

    folder: Path

    @classmethod
    def at(cls, folder: Path, scale: Scale) -> Store:
        """The store in `folder`. Raises OutputError where another study, or something else, is in it."""
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
        return self._path(name, "npz").exists() or self._path(name, "json").exists()

    def errors(self, name: str, compute: Callable[[], Errors]) -> Errors:
        """The errors kept under a name, or those computed now."""
        path = self._path(name, "npz")
        if not path.exists():
            arrays = _flat(compute())
            with written_aside(path) as aside, aside.open("wb") as file:
                np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
        with np.load(path) as kept:
            return _errors({key: kept[key] for key in kept.files})

    def text(self, name: str, compute: Callable[[], object]) -> object:
        """What is kept under a name, or computed now: anything that JSON holds."""
        path = self._path(name, "json")
        if not path.exists():
            words = json.dumps(compute())
            with written_aside(path) as aside:
                aside.write_text(words, encoding="utf-8")
        return json.loads(path.read_text(encoding="utf-8"))

    def _path(self, name: str, kind: str) -> Path:
        return self.folder / f"{re.sub(r'[^A-Za-z0-9]+', '-', name)}.{kind}"


def _flat(errors: Errors) -> dict[str, Array]:
    found = {_SEP.join(("absolute", *key)): v for key, v in errors.absolute.items()}
    found |= {_SEP.join(("squared", *key)): v for key, v in errors.squared.items()}
    found |= {_SEP.join(("samples", case)): v for case, v in errors.samples.items()}
    found |= {_SEP.join(("indefinite", a)): v for a, v in errors.indefinite.items()}
    if (shown := errors.example) is not None:
        found |= {"example|time": shown.time, "example|measured": shown.measured}
        found |= {_SEP.join(("predicted", a)): v for a, v in shown.predicted.items()}
    return found


def _errors(kept: Mapping[str, Array]) -> Errors:
    def part(name: str) -> dict[tuple[str, ...], Array]:
        return {tuple(key.split(_SEP)[1:]): v for key, v in kept.items() if key.startswith(name + _SEP)}

    shown = part("example")
    example = (
        Example(shown["time",], shown["measured",], {a: v for (a,), v in part("predicted").items()}) if shown else None
    )
    return Errors(
        {(a, c): v for (a, c), v in part("absolute").items()}, {(a, c): v for (a, c), v in part("squared").items()},
        {c: v for (c,), v in part("samples").items()}, {a: v for (a,), v in part("indefinite").items()}, example,
    )  # fmt: skip
