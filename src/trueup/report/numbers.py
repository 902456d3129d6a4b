# SPDX-License-Identifier: Apache-2.0
"""How numbers and names are written: as many digits as the interval supports, in a unit that needs no zeros."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

_MILLI = {"rad": "mrad", "rad/s": "mrad/s", "m": "mm", "m/s": "mm/s", "N m": "mN m", "A": "mA", "V": "mV", "s": "ms"}
_ABSENT = "–"
_MINUS = "−"
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Scale:
    """A unit to show values in: shown = value * factor."""

    unit: str
    factor: float

    def text(self, value: float, digits: int = 3) -> str:
        """`value` (in the unit before scaling) as a number in this unit, without the unit."""
        return significant(value * self.factor, digits)


def scale_for(unit: str, sizes: Iterable[float]) -> Scale:
    """The scale for errors of these `sizes` in `unit`: thousandths where the smallest size is below 0.1."""
    finite = [abs(size) for size in sizes if math.isfinite(size) and size != 0.0]
    if finite and min(finite) < 0.1 and unit in _MILLI:
        return Scale(_MILLI[unit], 1000.0)
    return Scale(unit, 1.0)


def significant(value: float, digits: int = 3) -> str:
    """`value` with that many significant digits; very large and small ones as a power of ten, NaN as a dash."""
    if math.isnan(value):
        return _ABSENT
    if math.isinf(value) or value == 0.0:
        return fixed(value, 0)
    rounded = float(f"{value:.{digits - 1}e}")  # 0.9996 becomes 1.00, not 1.000
    return fixed(rounded, digits - 1 - math.floor(math.log10(abs(rounded))))


def fixed(value: float, decimals: int) -> str:
    """`value` rounded to `decimals` digits behind the point (negative: before it), with a real minus sign."""
    if math.isnan(value):
        return _ABSENT
    if math.isinf(value):
        return "∞" if value > 0 else f"{_MINUS}∞"
    if value == 0.0 and decimals > 7:
        return "0"
    if abs(value) >= 1e6 or (decimals > 7 and abs(value) < 1e-3):
        return _power_of_ten(value, decimals)
    text = f"{round(value, decimals):.{max(decimals, 0)}f}"
    if float(text) == 0.0:
        text = text.lstrip("-")
    return text.replace("-", _MINUS)


def supported_decimals(value: float, low: float, high: float) -> int:
    """Decimals for a value with the interval [low, high]: two significant digits of the interval's half width.

    At most six significant digits of the larger end, and four of `value` where there is no interval.
    """
    half = (high - low) / 2
    largest = max((abs(x) for x in (value, low, high) if math.isfinite(x)), default=0.0)
    if largest == 0.0:
        return 0
    magnitude = math.floor(math.log10(largest))
    if not math.isfinite(half) or half <= 0.0:
        return 3 - magnitude
    return min(1 - math.floor(math.log10(half)), 5 - magnitude)


def ratio_text(after: float, before: float) -> str:
    """The ratio after / before as '0.27×', a dash where that is no number."""
    if not (math.isfinite(after) and math.isfinite(before)) or before == 0.0:
        return _ABSENT
    ratio = after / before
    return f"{fixed(ratio, 2) if ratio < 9.995 else significant(ratio)}×" if ratio >= 0.005 else "<0.01×"


def duration_text(seconds: float) -> str:
    """A time span for people: '0.84 s', '41.2 s', '3 min 20 s', '2 h 05 min'."""
    if not math.isfinite(seconds):
        return _ABSENT
    if seconds < 99.5:
        return f"{significant(seconds)} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"


def duration_of_a_call(seconds: float) -> str:
    """A time far below a second: '0.62 µs', '0.11 ms'."""
    return f"{significant(1e6 * seconds, 2)} µs" if seconds < 1e-4 else f"{significant(1e3 * seconds, 2)} ms"


def with_unit(number: str, unit: str) -> str:
    """The number and its unit, kept on one line."""
    return f"{number}\u00a0{unit}" if unit else number


def shortened(text: str, most: int) -> str:
    """`text` with an ellipsis in its middle where it is longer than `most` characters."""
    if len(text) <= most:
        return text
    return f"{text[: most // 2]}…{text[len(text) - (most - most // 2 - 1) :]}"


def _power_of_ten(value: float, decimals: int) -> str:
    magnitude = math.floor(math.log10(abs(value)))
    mantissa = value / 10.0**magnitude
    digits = min(max(decimals + magnitude, 0), 5)
    return f"{mantissa:.{digits}f}·10{str(magnitude).translate(_SUPERSCRIPT)}".replace("-", _MINUS, 1)
