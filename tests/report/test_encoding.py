# SPDX-License-Identifier: Apache-2.0
"""Thinning loses no extreme, packing loses nothing that can be seen."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from trueup.report.encoding import MISSING, kept_samples, packed


def unpacked(column: dict[str, Any]) -> np.ndarray:
    """The values of `packed`, as the browser sees them."""
    raw = base64.b64decode(column["d"])
    if column["k"] == "f4":
        return np.frombuffer(raw, "<f4").astype(float)
    codes = np.frombuffer(raw, "<i2")
    return np.where(codes == MISSING, np.nan, column["o"] + column["s"] * codes)


@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(500, 5000))
@settings(max_examples=40, deadline=None)
def test_thinning_keeps_the_extremes_and_the_ends(seed: int, lines: int, count: int) -> None:
    random = np.random.default_rng(seed)
    values = [np.where(random.random(count) < 0.05, np.nan, random.standard_cauchy(count)) for _ in range(lines)]
    kept = kept_samples(values, 300)
    assert kept.size <= 302
    assert (np.diff(kept) > 0).all()
    assert (kept[0], kept[-1]) == (0, count - 1)
    for line in values:
        assert np.nanmax(line[kept]) == np.nanmax(line)
        assert np.nanmin(line[kept]) == np.nanmin(line)


def test_few_samples_are_all_kept() -> None:
    assert kept_samples([np.zeros(200)], 300).size == 200
    assert kept_samples([np.zeros(0)], 300).size == 0


@given(
    arrays(np.float64, st.integers(0, 60), elements=st.floats(-(2.0**100), 2.0**100, width=32) | st.just(float("nan")))
)
@settings(deadline=None)
def test_packing_is_finer_than_a_thousandth_of_the_signal(values: np.ndarray) -> None:
    back = unpacked(packed(values))
    assert (np.isnan(back) == np.isnan(values)).all()
    finite = values[np.isfinite(values)]
    if finite.size:
        low, high = np.percentile(finite, [5, 95])
        allowed = 6e-4 * (high - low) + 1.2e-7 * np.abs(finite) + 1e-37
        assert (np.abs(back[np.isfinite(values)] - finite) <= allowed).all()


def test_an_outlier_does_not_make_the_rest_coarse() -> None:
    values = np.sin(np.arange(1000) / 50)
    values[500] = 1e7
    assert np.abs(unpacked(packed(values)) - values)[:500].max() < 1e-6


def test_an_ordinary_line_takes_two_bytes_a_sample() -> None:
    assert len(packed(np.sin(np.arange(3000) / 50))["d"]) == pytest.approx(3000 * 2 * 4 / 3, abs=4)


def test_infinite_values_become_missing() -> None:
    assert np.isnan(unpacked(packed(np.array([1.0, np.inf, -np.inf, 2.0])))[1:3]).all()
