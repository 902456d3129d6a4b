# SPDX-License-Identifier: Apache-2.0
"""Where the papers' ordering appears: ratios of errors with speed, the planner's abruptness and hidden effects as factors."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array
from trueup.studies.arm.comparison import CASES, Errors, redrawn, weights

Key = tuple[str, str]
"""Algorithm and test case."""

SPEEDS, RAMPS = ("fast", "slow"), ("gentle", "abrupt")
CLAIMS = {
    "B over A in its region": (("B {speed}", "1 local, {speed}"), ("A", "1 local, {speed}")),
    "B over A_local in its region": (("B {speed}", "1 local, {speed}"), ("A_local", "1 local, {speed}")),
    "B over A on wide sines": (("B {speed}", "2 wide sines"), ("A", "2 wide sines")),
    "A on wide planner motion over A on sines": (("A", "3 wide planner, {ramp}"), ("A", "2 wide sines")),
    "B over A on wide planner motion": (("B {speed}", "3 wide planner, {ramp}"), ("A", "3 wide planner, {ramp}")),
    "ours over the best rival": (("ours", "{any}"), ("rival", "{any}")),
}
"""What is set in ratio: (algorithm, test case) over (algorithm, test case). The papers: below one, about or below one, far
above one, far above one, above one."""
_DRAWS = 1000


@dataclass(frozen=True)
class Cell:
    """One combination of factors."""

    region: str
    effects: str
    speed: str
    """Of algorithm B and of test case 1."""
    ramp: str
    """Of the planner in test case 3."""


@dataclass(frozen=True, eq=False)
class Ratio:
    """A ratio of two mean errors, the geometric mean of six axes."""

    draws: Array
    """Its logarithm with excitations and test motions drawn anew."""
    value: float
    below: int
    """Axes on which it is surely below one: the 95 % interval lies there."""
    above: int

    @property
    def text(self) -> str:
        """The ratio with its interval, and on how many axes it is surely below and above one."""
        return f"{self.value:.2f} [{bounds(self.draws)}] {self.below}/{self.above}"


def bounds(draws: Array) -> str:
    """The 95 % interval of a ratio whose logarithm is drawn."""
    low, high = np.exp(np.quantile(draws, [0.025, 0.975]))
    return f"{low:.2f}, {high:.2f}"


def ratios(everything: Mapping[str, Mapping[str, Errors]], seed: int) -> dict[tuple[Cell, str], Ratio]:
    """Every claim for every combination of region, hidden effects, speed and abruptness.

    All conditions of a region share excitations and test motions, so they are drawn alike: differences are paired.
    """
    found = {}
    for region, each in everything.items():
        for effects, errors in each.items():
            means = _bootstrap(errors, np.random.default_rng([seed, *region.encode()]))
            for speed, ramp in itertools.product(SPEEDS, RAMPS):
                cell = Cell(region, effects, speed, ramp)
                for claim in CLAIMS:
                    found[cell, claim] = _ratio(errors, means, claim, speed, ramp)
    return found


def _bootstrap(errors: Errors, rng: np.random.Generator) -> dict[Key, Array]:
    """(draws, 6) mean errors by algorithm and case."""
    R, N = next(iter(errors.absolute.values())).shape[:2]
    excitations, tests = weights(R, rng, _DRAWS), {case: weights(N, rng, _DRAWS) for case in CASES}
    return {(a, c): redrawn(values, excitations, tests[c]) for (a, c), values in errors.absolute.items()}


def _ratio(errors: Errors, means: Mapping[Key, Array], claim: str, speed: str, ramp: str) -> Ratio:
    pairs: list[tuple[Key, Key]] = []
    if claim.startswith("ours"):
        rivals = sorted({a for a, _ in errors.absolute if a != "ours"})
        for case in (f"1 local, {speed}", "2 wide sines", f"3 wide planner, {ramp}"):
            size = {a: float(np.log(errors.absolute[a, case].mean(axis=(0, 1))).mean()) for a in rivals}
            pairs.append((("ours", case), (min(rivals, key=lambda a, size=size: size[a]), case)))
    else:
        (a, one), (b, other) = CLAIMS[claim]
        named = [word.format(speed=speed, ramp=ramp) for word in (a, one, b, other)]
        pairs.append(((named[0], named[1]), (named[2], named[3])))
    logs = np.mean([np.log(means[one] / means[other]) for one, other in pairs], axis=0)  # (draws, 6)
    plain = np.mean(
        [np.log(errors.absolute[a].mean(axis=(0, 1)) / errors.absolute[b].mean(axis=(0, 1))) for a, b in pairs], axis=0
    )
    low, high = np.quantile(logs, [0.025, 0.975], axis=0)
    return Ratio(logs.mean(axis=1), float(np.exp(plain.mean())), int(np.sum(high < 0.0)), int(np.sum(low > 0.0)))


def main_effect(found: Mapping[tuple[Cell, str], Ratio], claim: str, factor: str, first: str, second: str) -> str:
    """What a factor's second level does to a claim's ratio, over its first one, averaged over all other factors.

    `factor` is a field of Cell. Levels of speed and ramp are compared under the main conditions only, not with effects left
    out one by one.
    """
    changes = []
    for cell in dict.fromkeys(cell for cell, _ in found):
        other = (replace(cell, **{factor: second}), claim)
        main = factor == "effects" or not cell.effects.startswith(("all but", "all effects,"))
        if getattr(cell, factor) == first and other in found and main:
            changes.append(found[other].draws - found[cell, claim].draws)
    draws = np.mean(changes, axis=0)
    same = np.abs(draws).max() < 1e-12
    return "-" if same else f"x {np.exp(draws.mean()):.2f} [{bounds(draws)}]"
