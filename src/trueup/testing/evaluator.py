# SPDX-License-Identifier: Apache-2.0
"""What every evaluator must keep: the numbers of the work itself, its errors, and who failed."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.errors import ParameterError
from trueup.evaluation.evaluator import Evaluator, Outcome, Work


def check_evaluator(evaluator: Evaluator) -> None:
    """Raises AssertionError where an evaluator breaks the contract of `trueup.evaluation.evaluator.Evaluator`."""
    rows = np.random.default_rng(0).standard_normal((23, 3))
    rows[5] = np.nan
    done = evaluator.evaluate(Work(_numbered, (2.0,), 2, "numbered"), rows)
    right = _numbered(2.0, rows, 0)
    assert np.array_equal(done.values, right.values, equal_nan=True), (
        "rows give what they give elsewhere, in their order"
    )
    assert dict(done.failures) == dict(right.failures), "a row that fails is named, with the reason"
    said = ""
    try:
        evaluator.evaluate(Work(_refusing, ()), rows)
    except ParameterError as error:
        said = str(error)
    assert "no such parameter" in said, "what the work raises on purpose is raised, in its words"


def _numbered(factor: float, rows: Array, first: int) -> Outcome:
    values: Array = np.stack([factor * rows.sum(axis=1), first + np.arange(len(rows), dtype=np.float64)], axis=1)
    failed = np.isnan(rows).any(axis=1)
    values[failed] = np.nan
    return Outcome(values, {int(row): "it was not finite" for row in np.flatnonzero(failed)})


def _refusing(rows: Array, first: int) -> Outcome:
    raise ParameterError("there is no such parameter")
