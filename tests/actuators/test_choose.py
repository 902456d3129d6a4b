# SPDX-License-Identifier: Apache-2.0
"""Which structures are kept, by left-out errors that are given."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np
import pytest

from trueup.actuators.choose import Asked, Chooser, Model, choose
from trueup.actuators.fit import Found
from trueup.actuators.structures import BY_NAME, LOAD, Structure


def model(errors: Sequence[float], names: tuple[str, ...] = ()) -> Model:
    found = Found({"loss": float(np.sum(errors))}, float(np.sum(errors)), 1.0, ())
    return Model(names, found, (), np.asarray(errors, dtype=np.float64))


class Foretold(Chooser):
    """A profile and full duty help together, and each by itself is a nuisance; all else does nothing."""

    def __init__(self) -> None:
        self.problem = SimpleNamespace(losses=lambda rows, *_: np.array([r["loss"] for r in rows]))  # type: ignore[assignment]
        self.declared, self.fixed = {}, {}

    def plain(self, structures: tuple[str, ...] = ()) -> Model:
        both = {"profile speed", "voltage limit"} & set(structures)
        size = (1.0, 1.1, 0.1)[len(both)] * (1.0 if LOAD in structures else 1.3) * 1.001 ** len(structures)
        return model((size * np.linspace(0.9, 1.1, 8)).tolist(), structures)

    def promise(self, model: Model, structure: Structure) -> Found:
        return self.plain((*model.structures, structure.name)).optimum

    def with_structure(self, model: Model, structure: Structure, promised: Found) -> Model:
        return self.plain((*model.structures, structure.name))

    def without(self, model: Model, name: str) -> Model:
        return self.plain(tuple(s for s in model.structures if s != name))

    def _from(self, model: Model, names: tuple[str, ...], iterations: int = 30) -> Found:
        return self.plain(names).optimum

    def _best(self, names: tuple[str, ...], fits: Sequence[Found]) -> Model:
        return self.plain(names)


def test_structures_that_help_only_together_are_found() -> None:
    best, asked = choose(Foretold(), list(BY_NAME), lambda *_: None)
    assert set(best.structures) == {LOAD, "profile speed", "voltage limit"}
    assert {a.name for a in asked if a.accepted} == set(best.structures)


@pytest.mark.parametrize(
    ("with_it", "wanted"),
    [
        ([6.0, 6.0, 15.0, 15.1, 14.9, 15.0, 15.0, 15.1], True),  # a limit that two recordings reach
        ([6.0, 60.0, 15.1, 15.1, 15.0, 15.0, 15.0, 15.1], False),  # one recording alone may be luck
        ([20.0, 20.0, 15.0, 15.0, 15.0, 15.0, 15.0, 60.0], False),  # another speaks against it
    ],
)
def test_a_structure_that_few_recordings_show_is_kept_where_none_is_worse(with_it: list[float], wanted: bool) -> None:
    assert Asked.of("x", model([60.0, 60.0, *[15.0] * 6]), model(with_it)).wanted == wanted
