# SPDX-License-Identifier: Apache-2.0
"""Units as people write them, converted to SI: `value_in_si = value * factor + offset`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

from trueup.arrays import Array
from trueup.errors import unknown_name

_DEGREE, _TURN = math.radians(1.0), math.tau

GRAVITY = 9.81
"""m/s2, near the ground; what model files say counts before it."""
EARTH = (9.76, 9.84)
"""m/s2: the least and the largest on Earth's surface (C. Hirt et al., "New ultrahigh-resolution picture of Earth's gravity
field", 2013), to the digits that people give; files differ by as much."""

FULL_LOCK = math.pi / 2.0
"""rad: no wheel is steered further."""

PULSE_MIDDLE, PULSE_FULL = 1500.0, 500.0
"""us, of the pulses that servos and motor controllers of models are told by: the middle, and how far its ends are from it."""

FURTHEST_TURN = 2.0 * _TURN
"""rad. Joints of arms and legs stay within two turns of their zero, while 12.6 degrees are a small motion: angles that
reach further are in degrees, or those of a motor before its gear."""

AS_FAR = 2.0
"""Times as far, or as little, as what it follows that nothing goes in the same unit, be it soft, filtered or late; commands
that are so many times the full one are no shares of it."""

_UNITS: Mapping[str, tuple[str, float, float]] = MappingProxyType(
    {
        "": ("", 1.0, 0.0),
        "%": ("", 0.01, 0.0),
        "permille": ("", 0.001, 0.0),
        "s": ("s", 1.0, 0.0),
        "ms": ("s", 1e-3, 0.0),
        "us": ("s", 1e-6, 0.0),
        "ns": ("s", 1e-9, 0.0),
        "min": ("s", 60.0, 0.0),
        "h": ("s", 3600.0, 0.0),
        "Hz": ("Hz", 1.0, 0.0),
        "rad": ("rad", 1.0, 0.0),
        "mrad": ("rad", 1e-3, 0.0),
        "deg": ("rad", _DEGREE, 0.0),
        "rev": ("rad", _TURN, 0.0),
        "rad/s": ("rad/s", 1.0, 0.0),
        "deg/s": ("rad/s", _DEGREE, 0.0),
        "rpm": ("rad/s", _TURN / 60.0, 0.0),
        "rev/s": ("rad/s", _TURN, 0.0),
        "rad/s^2": ("rad/s^2", 1.0, 0.0),
        "deg/s^2": ("rad/s^2", _DEGREE, 0.0),
        "m": ("m", 1.0, 0.0),
        "cm": ("m", 1e-2, 0.0),
        "mm": ("m", 1e-3, 0.0),
        "um": ("m", 1e-6, 0.0),
        "km": ("m", 1e3, 0.0),
        "m/s": ("m/s", 1.0, 0.0),
        "mm/s": ("m/s", 1e-3, 0.0),
        "cm/s": ("m/s", 1e-2, 0.0),
        "km/h": ("m/s", 1.0 / 3.6, 0.0),
        "mph": ("m/s", 0.44704, 0.0),
        "1/m": ("1/m", 1.0, 0.0),
        "m/s^2": ("m/s^2", 1.0, 0.0),
        "g0": ("m/s^2", 9.80665, 0.0),
        "kg": ("kg", 1.0, 0.0),
        "N": ("N", 1.0, 0.0),
        "kN": ("N", 1e3, 0.0),
        "N m": ("N m", 1.0, 0.0),
        "mN m": ("N m", 1e-3, 0.0),
        "N cm": ("N m", 1e-2, 0.0),
        "kgf cm": ("N m", 9.80665e-2, 0.0),
        "N m/rad": ("N m/rad", 1.0, 0.0),
        "N m s/rad": ("N m s/rad", 1.0, 0.0),
        "A": ("A", 1.0, 0.0),
        "mA": ("A", 1e-3, 0.0),
        "V": ("V", 1.0, 0.0),
        "mV": ("V", 1e-3, 0.0),
        "W": ("W", 1.0, 0.0),
        "K": ("K", 1.0, 0.0),
        "degC": ("K", 1.0, 273.15),
    }
)

_SPELLINGS: Mapping[str, str] = MappingProxyType(
    {
        "1": "",
        "-": "",
        "none": "",
        "sec": "s",
        "secs": "s",
        "second": "s",
        "seconds": "s",
        "msec": "ms",
        "millis": "ms",
        "milliseconds": "ms",
        "usec": "us",
        "µs": "us",
        "μs": "us",
        "micros": "us",
        "microseconds": "us",
        "nsec": "ns",
        "nanosec": "ns",
        "nanoseconds": "ns",
        "minutes": "min",
        "radian": "rad",
        "radians": "rad",
        "degree": "deg",
        "grad": "deg",
        "degrees": "deg",
        "°": "deg",
        "turn": "rev",
        "turns": "rev",
        "rad/sec": "rad/s",
        "rad*s^-1": "rad/s",
        "rads": "rad/s",
        "degree/s": "deg/s",
        "deg/sec": "deg/s",
        "°/s": "deg/s",
        "dps": "deg/s",
        "rev/min": "rpm",
        "rad/s2": "rad/s^2",
        "rad/s²": "rad/s^2",
        "deg/s2": "deg/s^2",
        "m/s2": "m/s^2",
        "m/s²": "m/s^2",
        "meter": "m",
        "metre": "m",
        "meters": "m",
        "m/sec": "m/s",
        "kmh": "km/h",
        "kph": "km/h",
        "nm": "N m",
        "nm/rad": "N m/rad",
        "nms/rad": "N m s/rad",
        "nm*s/rad": "N m s/rad",
        "n·m": "N m",
        "n*m": "N m",
        "n.m": "N m",
        "n-m": "N m",
        "newton meter": "N m",
        "mnm": "mN m",
        "ncm": "N cm",
        "kgf.cm": "kgf cm",
        "amp": "A",
        "amps": "A",
        "ampere": "A",
        "volt": "V",
        "volts": "V",
        "celsius": "degC",
        "°c": "degC",
        "kelvin": "K",
        "percent": "%",
        "prozent": "%",
        "‰": "permille",
    }
)


def to_si(unit: str) -> tuple[str, float, float]:
    """The SI unit of `unit`, and the factor and offset that lead to it: si = value * factor + offset.

    A unit that is not listed (encoder ticks, for one) has no fixed size: give its size as a scale, and the unit
    that results. Raises UnknownNameError, which lists the known units.
    """
    plain = canonical(unit)
    if plain is None:
        raise unknown_name("unit", unit, [u for u in _UNITS if u], "the units known (for ticks or counts give a scale)")
    return _UNITS[plain]


def size_of(unit: str) -> float:
    """How many SI units one of `unit` is: a thousandth for mm. Raises UnknownNameError as `to_si`."""
    _, factor, _ = to_si(unit)
    return factor


def numbers_of(unit: str) -> float:
    """How many of `unit` one SI unit is: a thousand for mm. Raises UnknownNameError as `to_si`."""
    return 1.0 / size_of(unit)


def hardly_radians(largest: float, reach: float = FURTHEST_TURN) -> bool:
    """Whether angles are too large to be in rad: the `largest` of them is beyond the `reach` [rad] of what turns."""
    return largest > reach


def canonical(unit: str) -> str | None:
    """The one spelling used here for `unit` ("Nm" -> "N m"), or None for a unit that is not known."""
    text = " ".join(unit.split())
    if text in _UNITS:
        return text
    if text.lower() in _SPELLINGS:
        return _SPELLINGS[text.lower()]
    # Prefixes make case matter in short units (mA, MA): only whole words are compared without it.
    return next((u for u in _UNITS if len(u) > 2 and u.lower() == text.lower()), None)


def are_pulses(values: Array) -> bool:
    """Whether finite numbers are the lengths in us of servos' pulses; zero is one that is not sent."""
    sent = values[values != 0.0]
    return len(sent) > 0 and bool((abs(sent - PULSE_MIDDLE) <= 2.0 * PULSE_FULL).all())
