# SPDX-License-Identifier: Apache-2.0
"""What is computed already, in the folder of the results: a study that was stopped goes on from there."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from trueup.arrays import Array
from trueup.formats.aside import written_aside
from trueup.studies.arm.comparison import Errors, Example
from trueup.studies.saved import Parts

_SEP = "|"


class Store(Parts):
    """A folder that holds one study: the errors of each condition, and further parts as JSON."""

    def errors(self, name: str, compute: Callable[[], Errors]) -> Errors:
        """The errors kept under a name, or those computed now."""
        path = self.path(name, "npz")
        if not path.exists():
            arrays = _flat(compute())
            with written_aside(path) as aside, aside.open("wb") as file:
                np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
        with np.load(path) as kept:
            return _errors({key: kept[key] for key in kept.files})


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
