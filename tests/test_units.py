# SPDX-License-Identifier: Apache-2.0
"""Units as people write them mean what physics says."""

from __future__ import annotations

import math

import pytest

from trueup.errors import UnknownNameError
from trueup.units import canonical, to_si


@pytest.mark.parametrize(
    ("value", "unit", "expected", "si"),
    [
        (180.0, "deg", math.pi, "rad"),
        (1.0, "rev", 2.0 * math.pi, "rad"),
        (60.0, "rpm", 2.0 * math.pi, "rad/s"),
        (1.5, "mA", 0.0015, "A"),
        (250.0, "mN m", 0.25, "N m"),
        (20.0, "degC", 293.15, "K"),
        (2.0, "min", 120.0, "s"),
        (5e6, "ns", 0.005, "s"),
        (36.0, "km/h", 10.0, "m/s"),
        (7.0, "", 7.0, ""),
    ],
)
def test_a_quantity_keeps_its_size_in_si(value: float, unit: str, expected: float, si: str) -> None:
    found, factor, offset = to_si(unit)
    assert found == si
    assert value * factor + offset == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("spelling", ["Nm", "N*m", "N.m", "n m", "N·m", " N  m "])
def test_spellings_of_one_unit_are_one_unit(spelling: str) -> None:
    assert canonical(spelling) == "N m"


def test_case_tells_milli_from_mega() -> None:
    assert canonical("mA") == "mA"
    assert canonical("MA") is None


def test_an_unknown_unit_lists_those_that_are_known() -> None:
    with pytest.raises(UnknownNameError, match=r"unit 'ticks' .*scale.* units are: .*km/h"):
        to_si("ticks")
