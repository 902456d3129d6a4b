# SPDX-License-Identifier: Apache-2.0
"""What every Search must do, whatever its method."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.search.search import Search
from trueup.testing.broken import require


def check_search(
    make: Callable[[Array], Any], *, residuals: bool = False, rounds: int = 400, tolerance: float = 1e-2
) -> None:
    """Checks the contract of `Search`; `make(start)` returns a new search from start (n,), with resume(state).

    It asks inside the box, finds the minimum of a bowl with one coordinate at a bound, survives failed evaluations, its
    state is JSON, and resumed in the middle it ends where an uninterrupted one does. `residuals`: it is told (b, m)
    residuals instead of losses. `tolerance`: how near is near enough, for searches that never
    settle. Raises ContractBrokenError (an AssertionError) that says what was broken.
    """
    target = np.array([0.3, 0.7, -0.2])
    start = np.array([0.5, 0.5, 0.5])
    bottom = np.array([0.3, 0.7, 0.0])
    search = make(start)
    found = _run(search, target, residuals, rounds)
    require(bool(search.done), f"the search had not ended after {rounds} rounds")
    require(np.abs(found - bottom).max() < tolerance, f"the minimum of a bowl is {bottom}, found {found}")
    failing = _run(make(start), target, residuals, rounds, fails=True)
    require(np.abs(failing - bottom).max() < 5.0 * tolerance, f"with failed evaluations the search ended at {failing}")
    first = make(start)
    _run(first, target, residuals, 5)
    saved = json.loads(json.dumps(first.state()))
    second = make(start)
    second.resume(saved)
    resumed = _run(second, target, residuals, rounds)
    require(np.allclose(resumed, found, atol=1e-3), f"resumed it ends at {resumed}, uninterrupted at {found}")


def _run(search: Search, target: Array, residuals: bool, rounds: int, *, fails: bool = False) -> Array:
    scale = np.array([30.0, 10.0, 20.0])
    for turn in range(rounds):
        if search.done:
            break
        candidates = search.ask()
        asked = np.array(candidates)
        require(asked.ndim == 2 and asked.shape[1] == len(target), f"ask returned shape {asked.shape}")
        require(bool(((asked >= 0.0) & (asked <= 1.0)).all()), "asked for a candidate outside the unit box")
        rows = (asked - target) * scale
        told = rows if residuals else (rows**2).sum(axis=1)
        if fails and turn % 3 == 1:
            told = told.copy()
            told[-1] = np.nan
        search.tell(candidates, told)
        require(np.array_equal(candidates, asked), "tell wrote into its candidates")
    return np.asarray(search.best[0])
