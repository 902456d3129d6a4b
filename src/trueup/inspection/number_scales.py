# SPDX-License-Identifier: Apache-2.0
"""In which numbers servos are told where to go, other than rad: counts, pulses, shares of a range, parts of degrees."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.evidence import STANDARD_ERRORS
from trueup.inspection.relations import TOLERANCE
from trueup.inspection.scales import BESIDE, Way
from trueup.inspection.zeros import FAR
from trueup.units import PULSE_FULL, PULSE_MIDDLE, numbers_of


@dataclass(frozen=True)
class NumberScale:
    """Numbers `per` rad (or m) that are `zero` where a joint is at zero, and lie between two ends."""

    words: str
    per: float
    zero: float = 0.0
    ends: tuple[float, float] = (-math.inf, math.inf)


def _in_degrees(words: str, numbers: float, degrees: float, zero: float, *ends: float) -> NumberScale:
    return NumberScale(words, numbers / math.radians(degrees), zero, (ends[0], ends[1]) if ends else NumberScale.ends)


def _of_pulses(us: float, degrees: float) -> NumberScale:
    ends = PULSE_MIDDLE - 2.0 * PULSE_FULL, PULSE_MIDDLE + 2.0 * PULSE_FULL
    return _in_degrees(f"pulses of {us:g} us in {degrees:g} degrees", us, degrees, PULSE_MIDDLE, *ends)


_OF_ANGLES = (
    *(_in_degrees(f"{2**k} counts a turn", 2.0**k, 360.0, 2.0 ** (k - 1), 0.0, 2.0**k) for k in range(9, 21)),
    *(_in_degrees(f"{2**k} counts a turn", 2.0**k, 360.0, 0.0) for k in range(9, 21)),
    _in_degrees("1023 counts in 300 degrees, as of Dynamixel AX and XL-320", 1023.0, 300.0, 512.0, 0.0, 1023.0),
    _in_degrees("1000 counts in 240 degrees, as of LewanSoul LX servos", 1000.0, 240.0, 500.0, 0.0, 1000.0),
    _of_pulses(1000.0, 90.0),
    _of_pulses(2000.0, 270.0),
    NumberScale("mrad", numbers_of("mrad")),
    _in_degrees("turns", 1.0, 360.0, 0.0),
    _in_degrees("degrees", 1.0, 1.0, 0.0),
    _in_degrees("tenths of degrees", 10.0, 1.0, 0.0),
    _in_degrees("hundredths of degrees", 100.0, 1.0, 0.0),
    _in_degrees("thousandths of degrees", 1000.0, 1.0, 0.0),
)
_OF_LENGTHS = (NumberScale("mm", numbers_of("mm")), NumberScale("cm", numbers_of("cm")))
APART = min(abs(math.log(a.per / b.per)) for a in _OF_ANGLES for b in _OF_ANGLES if a.per != b.per)
"""Of a factor, relative: those of pulses and of a servo's 4096 counts are not further apart."""


@dataclass(frozen=True, eq=False)
class Seen:
    """What a joint's numbers are by how it follows them: `per` rad or m, `zero` where it is at zero; from `low` to `high`."""

    way: Way
    per: float
    zero: float
    low: float
    high: float
    error: float = 0.0
    """Standard deviation of `per`, relative."""

    @property
    def near(self) -> float:
        """How far, in rad or m, which a joint may rest beside what it is told."""
        return BESIDE * (self.way.ends[1] - self.way.ends[0]) if self.way.slides else FAR


def known_scales(seen: Sequence[Seen]) -> tuple[NumberScale, ...]:
    """The only scale known that fits joints of one kind, as each of them has it; () where none does, or several do.

    How far the joints differ from one another tells how much weight and friction move their factors. Of one joint alone that
    is not known: where it is at zero in the middle of what its servo counts must tell it.
    """
    ranged = all(one.way.range is not None for one in seen)
    each = [_scales(one.way, ranged=ranged) for one in seen]
    off = np.array(
        [[math.log(abs(s.per) / scale.per) for scale in scales] for s, scales in zip(seen, each, strict=True)]
    )
    beside = np.array([[abs(s.zero - scale.zero) / scale.per / s.near for scale in scales]
                       for s, scales in zip(seen, each, strict=True)])  # fmt: skip
    inside = np.array([[scale.ends[0] <= s.low and s.high <= scale.ends[1] for scale in scales]
                       for s, scales in zip(seen, each, strict=True)]).all(axis=0)  # fmt: skip
    middle, error = np.abs(np.median(off, axis=0)), STANDARD_ERRORS * np.hypot(spread(off), sure_to(seen))
    centred = inside & (np.median(beside, axis=0) < 1.0)
    if len(seen) < 2:
        centred &= np.array([scale.zero != 0.0 for scale in each[0]])
    # Where no zero is in the middle, the factor alone must tell.
    sure = inside & (error < 0.5 * APART) & (len(seen) > 1)
    for allowed, near in ((centred, TOLERANCE), (centred, 0.5 * APART), (sure & ~centred.any(), 0.5 * APART)):
        fits = allowed & (middle < np.maximum(error, near))
        if len({each[0][k].words for k in np.flatnonzero(fits)}) == 1:
            best = min(np.flatnonzero(fits), key=lambda k: float(np.median(beside[:, k])))
            return tuple(scales[best] for scales in each)
    return ()


def sure_to(seen: Sequence[Seen]) -> float:
    """Standard error of the mean factor of joints, relative, by how well each of them is known."""
    return float(np.median([one.error for one in seen])) / math.sqrt(len(seen))


def spread(off: Array) -> Array:
    """(k,) standard errors of means over joints of (n, k) logarithms; 0 of a single joint."""
    return np.std(off, axis=0, ddof=1) / math.sqrt(len(off)) if len(off) > 1 else np.zeros(off.shape[1:])


def _scales(way: Way, *, ranged: bool) -> tuple[NumberScale, ...]:
    known = _OF_LENGTHS if way.slides else _OF_ANGLES
    if not ranged:
        return known
    (low, high), found = way.ends, list(known)
    for words, whole in (("percent", 100.0), ("shares", 1.0)):
        per = whole / (high - low)
        found += [
            NumberScale(f"{words} of the range", per, -per * low, (-BESIDE * whole, (1.0 + BESIDE) * whole)),
            NumberScale(f"{words} of half the range, from its middle", 2.0 * per, -per * (low + high),
                        (-(1.0 + BESIDE) * whole, (1.0 + BESIDE) * whole)),
        ]  # fmt: skip
    return tuple(found)


def groups(pers: Mapping[str, float], apart: float) -> list[list[str]]:
    """Joints whose factors are not further from the median of the rest than `apart` times, largest such group first."""
    left, found = dict(pers), list[list[str]]()
    while left:
        middle = sorted(left.values())[len(left) // 2]
        found.append([joint for joint, per in left.items() if max(per / middle, middle / per) <= apart])
        left = {joint: per for joint, per in left.items() if joint not in found[-1]}
    return found
