# SPDX-License-Identifier: Apache-2.0
"""What is to be thought of an estimate by its interval, in a word."""

from __future__ import annotations

from dataclasses import dataclass

from trueup.parameters import Parameter
from trueup.samples import MOST

# Nothing is less certain than "anywhere in the box": a uniform prior's variance is 1 / 12.
PRIOR = 12.0

AT_BOUND = "at bound"
"""The word for what ends at an end of its box."""
ROUGH = frozenset(["weak", "not identified", "no effect"])
"""Words for what is known roughly or not at all, whatever its value."""


@dataclass(frozen=True)
class Verdict:
    """What is to be thought of one estimate, and why."""

    word: str
    note: str = ""


def vague(spread: float) -> bool:
    """Whether a standard deviation, as a share of the box, says hardly more than that the value is somewhere in it."""
    return bool(spread * PRIOR**0.5 > MOST)


def judged(p: Parameter, unit: float, spread: float, value: float, low: float, high: float) -> Verdict:
    """On an estimate at `unit` of its box, with a standard deviation of `spread` there, which has an effect."""
    if vague(spread):
        return Verdict("not identified", f"the recordings leave it open{advice(p)}")
    if unit < 2e-3 or unit > 1 - 2e-3:
        which = "lower" if unit < 0.5 else "upper"
        if (p.optional or p.vanishes) and unit < 0.5:
            return Verdict(AT_BOUND, f"none is seen ({p.optional or p.name} at its {which} bound)")
        return Verdict(AT_BOUND, f"it wants to go beyond its {which} bound: widen it, or something else is missing")
    return roughly_known(p, spread, value, low, high) or Verdict("identified")


def roughly_known(p: Parameter, spread: float, value: float, low: float, high: float) -> Verdict | None:
    """The word for a value whose interval is wide beside it, with a standard deviation of `spread` in its box; None else."""
    size = max(abs(value), 1e-2 * (p.upper - p.lower))
    if (high - low) / 2 > 0.5 * size and spread > 0.02:
        return Verdict("weak", f"known to {100 * (high - low) / 2 / size:.0f} % only{advice(p)}")
    return None


def advice(p: Parameter) -> str:
    """What recordings would show it, as the end of a sentence."""
    return f"; {p.shown_by} would show it" if p.shown_by else ""
