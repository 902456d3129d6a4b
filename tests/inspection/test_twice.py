# SPDX-License-Identifier: Apache-2.0
"""What stands in two recordings is no motion that a fit did not see."""

from __future__ import annotations

import numpy as np

from trueup.inspection.twice import seen_twice
from trueup.recording import Channel, Recording

_TIME = 0.01 * np.arange(3000)
_ROWS = np.round(
    np.sin(np.array([0.9, 1.3]) * _TIME[:, None]) + np.random.default_rng(0).normal(0.0, 3e-4, (3000, 2)), 4
)


def _part(name: str, first: int, last: int, rows: np.ndarray = _ROWS) -> Recording:
    time = _TIME[first:last] - _TIME[first]  # each file has a clock of its own
    return Recording(name, {"position": Channel("position", ("a", "b"), "rad", time, rows[first:last])})


def test_what_was_held_out_and_stands_in_what_is_fitted_is_named_with_its_length() -> None:
    (said,) = seen_twice([_part("one", 0, 2000)], [_part("two", 1300, 3000)])
    assert "'two' is held out, yet 6.99 s of it stand in 'one' too" in said
    (said,) = seen_twice([_part("one", 0, 2000), _part("two", 1300, 3000)], [])
    assert "count twice" in said


def test_recordings_that_only_resemble_one_another_are_two() -> None:
    again = np.round(_ROWS + np.random.default_rng(1).normal(0.0, 3e-4, _ROWS.shape), 4)
    assert not seen_twice([_part("one", 0, 2000)], [_part("again", 0, 2000, again), _part("later", 2000, 3000)])
    rest = np.zeros((3000, 2))
    assert not seen_twice([_part("one", 0, 1000, rest)], [_part("two", 500, 1500, rest)])


def test_among_many_recordings_those_two_that_share_a_stretch_are_found() -> None:
    many = [_part(f"run {k}", 100 * k, 100 * k + 100) for k in range(30)]
    (said,) = seen_twice([*many, _part("copy", 410, 490)], [])
    assert "of 'run 4' stand in 'copy' too" in said
