# SPDX-License-Identifier: Apache-2.0
"""Optuna's samplers find minima, several candidates at once, resume bit for bit, and leave a study to look at."""

from __future__ import annotations

import importlib.util
import json
import logging
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pytest
from numpy.typing import NDArray

from trueup.errors import CalibrationError, MissingExtraError, OutputError
from trueup.search.optuna import OptunaSearch
from trueup.testing import check_search

Array = NDArray[np.float64]
SAMPLERS = ["tpe", "cma"]


def bowl(points: Array) -> Array:
    """Least at (0.3, 0.7, 0.5, ...), with losses told apart."""
    return ((points - np.resize([0.3, 0.7, 0.5], points.shape[1])) ** 2).sum(axis=1)


def run(search: OptunaSearch, rounds: int) -> None:
    for _ in range(rounds):
        search.tell(c := search.ask(), bowl(c))


@pytest.mark.parametrize(("sampler", "tolerance"), [("tpe", 5e-2), ("cma", 1e-2)])
def test_it_keeps_the_contract_of_searches(sampler: str, tolerance: float) -> None:
    make = lambda start: OptunaSearch(start, seed=1, sampler=sampler, trials=400)  # noqa: E731
    check_search(make, tolerance=tolerance)


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("moment", [1, 9, 23])
def test_a_resumed_search_proposes_the_same_bits(sampler: str, moment: int) -> None:
    def new() -> OptunaSearch:
        return OptunaSearch(np.full(4, 0.5), seed=5, sampler=sampler, trials=200, batch=3)

    whole, first = new(), new()
    run(whole, moment)
    run(first, moment)
    under_way = whole.ask(), first.ask()  # interrupted between ask and tell
    assert np.array_equal(*under_way)
    second = new()
    second.resume(json.loads(json.dumps(first.state())))
    for search in (whole, second):
        search.tell(under_way[0][::-1], bowl(under_way[0][::-1]))
    for _ in range(12):
        a, b = whole.ask(), second.ask()
        assert np.array_equal(a, b)
        whole.tell(a, bowl(a))
        second.tell(b, bowl(b))
    assert whole.state() == second.state()
    assert whole.best[1] == second.best[1]


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_several_candidates_under_way_differ_and_are_told_in_any_order(sampler: str) -> None:
    search = OptunaSearch(np.full(3, 0.5), seed=2, sampler=sampler, trials=60, batch=4)
    run(search, 10)
    asked = np.concatenate([search.ask(), search.ask()])
    assert len(np.unique(asked, axis=0)) == 8
    order = np.random.default_rng(0).permutation(8)
    search.tell(asked[order], bowl(asked[order]))
    with pytest.raises(CalibrationError, match="never asked for, or was told before"):
        search.tell(asked[:1], np.zeros(1))


def test_the_budget_is_kept_exactly() -> None:
    search = OptunaSearch(np.full(2, 0.5), seed=2, trials=10, batch=4)
    sizes = []
    while not search.done:
        search.tell(c := search.ask(), bowl(c))
        sizes.append(len(c))
    assert sizes == [4, 4, 2]
    assert search.done == "all 10 trials are told"
    assert search.ask().shape == (0, 2)


def test_the_first_candidate_is_the_start() -> None:
    assert OptunaSearch(np.array([0.2, 0.9]), seed=1).ask().tolist() == [[0.2, 0.9]]


def test_the_study_file_holds_every_trial_with_its_labels(tmp_path: Path) -> None:
    path = tmp_path / "study.db"
    search = OptunaSearch(np.array([0.2, 0.9]), seed=1, trials=30, path=path, study="gains", labels=("k1", "k2"))
    run(search, 12)
    search.save()  # in between, as for a look at it
    while not search.done:
        losses = bowl(c := search.ask())
        search.tell(c, np.where(c[:, 0] < 0.1, np.nan, losses))
    read = optuna.load_study(study_name="gains", storage=f"sqlite:///{path}").trials
    expected = search.study.trials
    assert [(t.number, t.params, t.values, t.state) for t in read] == [
        (t.number, t.params, t.values, t.state) for t in expected
    ]
    assert [t.datetime_complete for t in read] == [t.datetime_complete for t in expected]
    assert set(read[0].params) == {"k1", "k2"}


def test_an_interrupted_search_goes_on_in_its_study_file(tmp_path: Path) -> None:
    def new() -> OptunaSearch:
        return OptunaSearch(np.array([0.2, 0.9]), seed=1, trials=20, path=tmp_path / "s.db")

    first = new()
    run(first, 8)
    first.save()
    second = new()
    second.resume(first.state())
    run(second, 12)
    assert len(optuna.load_study(study_name="trueup", storage=f"sqlite:///{tmp_path / 's.db'}").trials) == 20
    other = OptunaSearch(np.array([0.3, 0.9]), seed=2, trials=20, path=tmp_path / "s.db")
    with pytest.raises(CalibrationError, match="holds a study 'trueup' with other trials"):
        run(other, 20)


def test_a_file_that_is_no_study_is_left_alone_and_named(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("mine " * 100)
    with pytest.raises(OutputError, match=r"notes\.txt: the study cannot be written"):
        run(OptunaSearch(np.full(2, 0.5), seed=1, trials=3, path=path), 3)
    assert path.read_text() == "mine " * 100


def test_optuna_says_nothing_and_keeps_the_users_level(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    optuna.logging.set_verbosity(logging.DEBUG)
    try:
        run(OptunaSearch(np.full(2, 0.5), seed=1, trials=15, path=tmp_path / "s.db"), 15)
        assert optuna.logging.get_verbosity() == logging.DEBUG
    finally:
        optuna.logging.set_verbosity(logging.INFO)
    assert capfd.readouterr() == ("", "")


def test_gaussian_processes_without_torch_say_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name == "torch" else find(name, *a))
    with pytest.raises(MissingExtraError, match=r"'torch': pip install 'trueup\[gp\]'"):
        OptunaSearch(np.full(2, 0.5), seed=1, sampler="gp")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"seed": 6}, "had seed 6, not 5"),
        ({"labels": ["a", "b"]}, "had labels"),
        ({"sampler": "cma"}, "had sampler cma"),
    ],
)
def test_another_search_is_not_resumed(changes: dict[str, Any], said: str) -> None:
    state = OptunaSearch(np.full(2, 0.5), seed=5).state()
    with pytest.raises(CalibrationError, match=said):
        OptunaSearch(np.full(2, 0.5), seed=5).resume({**state, **changes})


def test_an_unknown_sampler_is_named() -> None:
    with pytest.raises(CalibrationError, match="sampler 'bayes' is unknown; samplers are: tpe, gp, cma"):
        OptunaSearch(np.full(2, 0.5), seed=5, sampler="bayes")
