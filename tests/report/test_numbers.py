# SPDX-License-Identifier: Apache-2.0
"""Numbers carry the digits that their interval supports, and round axes are round."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from trueup.report.marks import mark_texts, nice_marks
from trueup.report.numbers import (
    duration_text,
    fixed,
    ratio_text,
    scale_for,
    shortened,
    significant,
    supported_decimals,
)
from trueup.report.plots import Plot


@pytest.mark.parametrize(
    ("value", "low", "high", "text"),
    [
        (0.43217, 0.4193, 0.4451, "0.432"),
        (17.8123, 16.1, 19.5, "17.8"),
        (1234.5, 900.0, 1600.0, "1230"),
        (0.00012345, 0.00011, 0.00014, "0.000123"),
        (-0.5, -0.9, -0.1, "−0.50"),
    ],
)
def test_a_value_has_two_digits_of_its_half_width(value: float, low: float, high: float, text: str) -> None:
    assert fixed(value, supported_decimals(value, low, high)) == text


def test_an_interval_of_no_width_does_not_ask_for_endless_digits() -> None:
    assert len(fixed(1 / 3, supported_decimals(1 / 3, 1 / 3 - 1e-13, 1 / 3 + 1e-13))) <= 8
    assert fixed(1 / 3, supported_decimals(1 / 3, math.nan, math.nan)) == "0.3333"


@given(st.floats(1e-12, 1e12) | st.floats(-1e12, -1e-12))
def test_a_written_number_reads_back_to_its_digits(value: float) -> None:
    text = significant(value, 3).replace("−", "-")
    if "·10" in text:
        mantissa, power = text.split("·10")
        number = float(mantissa) * 10.0 ** int(power.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")))
    else:
        number = float(text)
    assert number == pytest.approx(value, rel=0.0051)


def test_absent_and_endless_values_have_their_signs() -> None:
    assert fixed(0.0, supported_decimals(0.0, -1e-9, 1e-9)) == "0"  # it ended in a ValueError
    assert (significant(math.nan), fixed(math.inf, 2), fixed(-math.inf, 2)) == ("–", "∞", "−∞")
    assert ratio_text(math.nan, 1.0) == ratio_text(1.0, 0.0) == "–"
    assert (ratio_text(1.0, 4.0), ratio_text(12.34, 1.0), ratio_text(1e-9, 1.0)) == ("0.25×", "12.3×", "<0.01×")


def test_small_errors_are_shown_in_thousandths() -> None:
    assert scale_for("rad", [0.036, 0.009]).unit == "mrad"
    assert scale_for("rad", [0.3]).unit == "rad"
    assert scale_for("ticks", [0.001]).unit == "ticks"
    assert scale_for("m", [math.nan]).unit == "m"


def test_times_are_for_people() -> None:
    assert [duration_text(s) for s in (0.84, 41.23, 200.0, 7500.0)] == ["0.840 s", "41.2 s", "3 min 20 s", "2 h 05 min"]


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6), st.integers(2, 9))
@example(low=879609.9999999999, size=1e-06, most=6)
def test_axis_marks_are_few_round_and_inside(low: float, size: float, most: int) -> None:
    high = low + size
    marks = nice_marks(low, high, most)
    assert 1 <= len(marks) <= most or marks == [low, high]
    # A mark can be no closer than the numbers themselves are: at 1e6 two neighbours lie 1e-10 apart.
    reach = 1e-6 * size + 4.0 * math.ulp(max(abs(low), abs(high)))
    assert all(low - reach <= m <= high + reach for m in marks)
    assert len(mark_texts(marks)) == len(marks)


def test_axis_marks_are_written_with_the_digits_of_their_distance() -> None:
    assert mark_texts(nice_marks(0.0, 1.04, 6)) == ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]
    assert mark_texts(nice_marks(0.0, 57.0, 6)) == ["0", "10", "20", "30", "40", "50"]


def test_a_long_name_keeps_both_ends() -> None:
    assert shortened("abcdefghij", 10) == "abcdefghij"
    short = shortened("abcdefghijklmnop", 10)
    assert len(short) == 10
    assert short.startswith("abc")
    assert short.endswith("nop")


@pytest.mark.parametrize("width", [4.0, 14.0, 30.0])
def test_the_numbers_beside_a_map_are_within_its_picture(width: float) -> None:
    drawn = Plot((-0.5 * width, 0.5 * width), (-7.0, 1.0), width=215, height=190, equal=True).svg("a map")
    beside = re.findall(r'<text x="([\d.]+)"[^>]*text-anchor="end"[^>]*>([^<]*)<', drawn)
    assert beside
    assert all(float(x) > 7.0 * len(words) for x, words in beside)  # 7 pixels a digit of 12 pixels' height
