# SPDX-License-Identifier: Apache-2.0
"""What is put back to its start value is untold only where a search had come to its end without that."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from trueup.arrays import Array
from trueup.loop import chooser
from trueup.loop.chooser import Chooser
from trueup.loop.descent import Fit
from trueup.loop.fit import REFINEMENT
from trueup.loop.scans import missed
from trueup.loop.selection import Choice
from trueup.loop.watch import Watch
from trueup.parameters import Parameter, ParameterSpace

SPACE = ParameterSpace((Parameter("gain", "", 1.0, 0.0, 10.0), Parameter("limit", "", 1.0, 0.0, 10.0)))


def _fit(space: ParameterSpace, loss: float) -> Fit:
    """Ten residuals of that loss, whatever the values."""
    free = int(space.free.sum())
    residual = np.full(10, np.sqrt(2.0 * loss / 10.0))
    return Fit(space, np.full(free, 0.5), residual, np.ones((10, free)), np.ones(10), "", loss)


@pytest.mark.parametrize(("held", "kept"), [(20.0, ["limit"]), (105.0, [])])
def test_what_leads_lower_by_its_start_value_is_searched_from_there(
    monkeypatch: pytest.MonkeyPatch, held: float, kept: list[str]
) -> None:
    """A limit that was not met where the search was stuck, at a loss of 100, and is met at its start value."""
    asked: list[float] = []

    def untold(problem: object, found: Fit, *_: object) -> Choice:
        asked.append(found.loss)
        first = len(asked) == 1
        return Choice(("limit",), ("limit kept at 1: these recordings cannot tell it",)) if first else Choice((), ())

    def fit(problem: object, space: ParameterSpace, *_: object, **__: Any) -> Fit:
        return _fit(space, held if space["limit"].frozen else 5.0)

    for name, stub in (
        ("untold", untold),
        ("fit", fit),
        ("unit_covariance", lambda *_: np.eye(2)),
        ("shallow", lambda *_: []),
    ):
        monkeypatch.setattr(chooser, name, stub)
    problem: Any = SimpleNamespace(chance=lambda residual: 1.0)
    select = Chooser()
    found = select.ended(problem, _fit(SPACE, 100.0), Watch(), {"stages": REFINEMENT})
    assert [p.name for p in found.space.parameters if not p.frozen] == ["gain", *kept]
    assert found.loss == (5.0 if kept else held)
    assert list(select.choices[0].freeze) == ([] if kept else ["limit"])


@pytest.mark.parametrize(
    ("costs", "misses", "kept", "looks", "fits"),
    [((0.1, 0.1, 0.1), (), "", 1, 1), ((0.1, 0.1, 60.0), ("c",), "c", 2, 1), ((0.1, 0.1, 60.0), (), "c", 5, 2)],
)
def test_what_may_stay_at_its_start_value_is_asked_at_once(
    monkeypatch: pytest.MonkeyPatch, costs: tuple[float, ...], misses: tuple[str, ...], kept: str, looks: int, fits: int
) -> None:
    """Three parameters of a fit at a loss of 100, and what it costs to hold each; a score test finds those in `misses`."""
    space = ParameterSpace(tuple(Parameter(name, "", 1.0, 0.0, 10.0) for name in "abcd"))
    looked: list[str] = []
    searched: list[str] = []

    def holding(space: ParameterSpace, where: list[str]) -> Fit:
        where.append("".join(p.name for p in space.parameters if p.frozen))
        return _fit(space, 100.0 + sum(costs["abc".index(name)] for name in where[-1]))

    for name, stub in (
        ("untold", lambda *_: Choice((), ())),
        ("fit", lambda problem, space, *_, **__: holding(space, searched)),
        ("descended", lambda problem, found, *_: holding(found.space, looked)),
        ("unit_covariance", lambda *_: np.eye(4)),
        ("shallow", lambda *_: list(space.parameters[:3])),
        ("missed", lambda problem, found, held, need: [p for p in held if p.name in misses]),
    ):
        monkeypatch.setattr(chooser, name, stub)
    problem: Any = SimpleNamespace(chance=lambda residual: 1.0)
    select = Chooser()
    found = select.ended(problem, _fit(space, 100.0), Watch(), {"stages": REFINEMENT, "robust": 3.0})
    assert [p.name for p in found.space.parameters if not p.frozen] == [*kept, "d"]
    assert sorted(select.choices[0].freeze) == sorted(set("abc") - set(kept))
    assert (len(looked), len(searched)) == (looks, fits)


def test_what_is_held_at_its_start_value_may_leave_others_untold(monkeypatch: pytest.MonkeyPatch) -> None:
    """A limit that nothing tells any more once the damping is held: both end where they began, and each is asked once."""
    space = ParameterSpace(tuple(Parameter(name, "", 1.0, 0.0, 10.0) for name in ("gain", "limit", "damping")))

    def untold(problem: Any, found: Fit, *_: Any) -> Choice:
        some = ("limit",) if found.space["damping"].frozen and not found.space["limit"].frozen else ()
        return Choice(some, tuple(f"{name} kept" for name in some))

    asked: list[int] = []
    for name, stub in (
        ("untold", untold),
        ("fit", lambda problem, space, *_, **__: _fit(space, 100.0)),
        ("descended", lambda problem, found, *_: _fit(found.space, 100.0)),
        ("unit_covariance", lambda *_: np.eye(3)),
        ("shallow", lambda *_: asked.append(1) or [space["damping"]]),
        ("missed", lambda *_: []),
    ):
        monkeypatch.setattr(chooser, name, stub)
    problem: Any = SimpleNamespace(chance=lambda residual: 1.0)
    select = Chooser()
    found = select.ended(problem, _fit(space, 100.0), Watch(), {"stages": REFINEMENT, "robust": 3.0})
    assert [p.name for p in found.space.parameters if not p.frozen] == ["gain"]
    assert sorted(select.choices[0].freeze) == ["damping", "limit"]
    assert len(asked) == 1


def test_a_score_test_finds_what_a_fit_misses_that_holds_it() -> None:
    """Of two held parameters the recordings ask for the second, which only another size of it shows beside the gain."""
    slopes = np.random.default_rng(0).normal(size=(200, 3))

    def residuals(values: Array) -> Array:
        return (values - [2.0, 1.0, 4.0]) @ slopes.T

    space = ParameterSpace(tuple(Parameter(name, "", 1.0, 0.0, 10.0) for name in ("gain", "still", "moved")))
    held, here = space.left_open(["still", "moved"]), np.array([2.0, 1.0, 1.0])
    found = Fit(held, np.array([0.2]), residuals(here), 10.0 * slopes[:, :1], np.ones(200), "")
    problem: Any = SimpleNamespace(residuals=residuals, chance=lambda residual: 1.0)
    assert missed(problem, found, space.parameters[1:], 5.0) == [space["moved"]]
