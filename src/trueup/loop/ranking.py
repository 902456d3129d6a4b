# SPDX-License-Identifier: Apache-2.0
"""How well the simulator's ranking of candidates agrees with the robot's: rank correlations with an exact interval."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan

import numpy as np
from numpy.typing import ArrayLike

from trueup.arrays import Array
from trueup.rounding import CERTAIN


@dataclass(frozen=True)
class Agreement:
    """Kendall's tau with its interval, and Spearman's rho; 1: the same order, -1: the reverse. NaN below two pairs."""

    tau: float
    low: float
    high: float
    spearman: float
    count: int
    """Candidates that were compared."""


def agreement(predicted: ArrayLike, measured: ArrayLike, *, level: float = 0.95) -> Agreement:
    """Compares scores (c,) that a simulator predicted with those that the robot showed; pairs with NaN are left out.

    The interval is that of the expected tau under C. L. Mallows' model of rankings (Biometrika 44, 1957), whose chance of
    an order with d discordant pairs is proportional to exp(-theta d): exact for the few candidates that a robot can
    try, where a bootstrap of three in the right order would claim certainty. Tied pairs count half, and are taken
    against the bound in question.
    """
    a, b = np.asarray(predicted, dtype=np.float64), np.asarray(measured, dtype=np.float64)
    good = np.isfinite(a) & np.isfinite(b)
    a, b = a[good], b[good]
    n = len(a)
    if n < 2:
        return Agreement(nan, nan, nan, nan, n)
    i, j = np.triu_indices(n, 1)
    signs = np.sign(a[i] - a[j]) * np.sign(b[i] - b[j])
    ties = int(np.sum(signs == 0))
    discordant = int(np.sum(signs < 0))
    pairs = len(signs)
    tail = 0.5 * (1.0 - level)
    low = _expected_tau(n, _theta(n, discordant + ties, tail, at_most=True))
    high = _expected_tau(n, _theta(n, discordant, tail, at_most=False))
    return Agreement(1.0 - (2.0 * discordant + ties) / pairs, low, high, _spearman(a, b), n)


def _orders(n: int) -> Array:
    """(pairs + 1,) how many orders of n have d discordant pairs (Mahonian numbers), as shares."""
    counts = np.ones(1)
    for k in range(2, n + 1):
        counts = np.convolve(counts, np.full(k, 1.0 / k))
    return counts


def _chances(n: int, theta: float) -> Array:
    with np.errstate(divide="ignore"):
        logs = np.log(_orders(n))
    logs = logs - theta * np.arange(len(logs))
    chances = np.exp(logs - logs.max())
    return chances / chances.sum()


def _theta(n: int, discordant: int, tail: float, *, at_most: bool) -> float:
    """The theta under which as few (`at_most`) or as many discordant pairs have chance `tail`; by bisection."""
    low, high = -CERTAIN, CERTAIN
    for _ in range(80):
        middle = 0.5 * (low + high)
        chances = _chances(n, middle)
        chance = chances[: discordant + 1].sum() if at_most else chances[discordant:].sum()
        # With theta rising, few discordant pairs become likelier and many rarer.
        if (chance < tail) == at_most:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def _expected_tau(n: int, theta: float) -> float:
    chances = _chances(n, theta)
    pairs = len(chances) - 1
    return float(1.0 - 2.0 * (chances @ np.arange(pairs + 1)) / pairs)


def _spearman(a: Array, b: Array) -> float:
    ranks = [_ranks(a), _ranks(b)]
    spread = [r.std() for r in ranks]
    if min(spread) == 0.0:
        return nan
    return float(np.mean((ranks[0] - ranks[0].mean()) * (ranks[1] - ranks[1].mean())) / (spread[0] * spread[1]))


def _ranks(values: Array) -> Array:
    """Ranks from 1, ties share their mean."""
    smaller = (values[:, None] > values[None, :]).sum(axis=1)
    equal = (values[:, None] == values[None, :]).sum(axis=1)
    return 1.0 + smaller + 0.5 * (equal - 1)
