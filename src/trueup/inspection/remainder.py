# SPDX-License-Identifier: Apache-2.0
"""Whether what a calibrated vehicle is predicted wrong by goes with what it was told: then its structure is another one.

No list of vehicles is looked through (trailers, rear wheels that steer, tyres that scrub): a regression without any structure
is asked, and has to foretell what it did not see. The same is asked of how long the vehicle has driven (a battery that
empties) and of which way it faces (a floor that slopes).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.evidence import EXPLAINED, FEWEST_PARTS, Evidence, evidence
from trueup.rounding import TINY

EVERY = 0.25
"""In s between predictions."""
STRETCH = 10.0
"""In s: what is left out together, several times as long as a prediction."""
SIDES = ("position along the vehicle", "position across the vehicle", "heading")
TOLD, DRIVEN, FACED = "what was commanded", "how long the vehicle had driven", "which way the vehicle faced"
MEANS = {
    TOLD: "The vehicle moves in a way that the simulated one cannot (as with a trailer, with wheels that steer or slip "
    "otherwise, or with something else that was commanded and is not in the mapping), and values found for it make up for "
    "that",
    DRIVEN: "Something changes while it drives that the simulated one keeps (as where a battery empties, or motors and tyres "
    "get warm), and values found for it are those of a mean of the drives",
    FACED: "Something of the place acts on it that the simulated one does not know (as on a floor that slopes, or in wind), "
    "and values found for it make up for that",
}
"""What errors may go with, and what that means."""


@dataclass(frozen=True, eq=False)
class Astray:
    """(S,) predictions of one drive, and what the vehicle had been told and did when each began."""

    begun: Array
    """(S,) in s."""
    errors: Array
    """(S, 3) of how far it goes ahead and to its left (m), and turns (rad), in the second half of each prediction: what was
    unsure where it began is hardly in that."""
    noise: Array
    """(3,) standard deviations of these as they are measured, pose by pose."""
    beside: Mapping[str, Array]
    """(S, F) of each of `MEANS`: means of commands around each prediction, and speed and turn rate where it began, with
    their products; the time driven, from the middle of the drive, and its products with means of commands; cosines and sines
    of the heading.
    """


def unlike(each: Sequence[Astray], horizon: float) -> tuple[str, ...]:
    """What to say of drives whose errors `horizon` s ahead a regression foretells, on what does so best: nothing where
    left-out errors do not become half as large, by the rule of evidence.
    """
    if not each:
        return ()
    beyond = _beyond_noise(each)
    asked = [(cause, side, e, b) for cause in MEANS
             for side, e, b in zip(SIDES, foretold(each, horizon, cause), beyond, strict=True)]  # fmt: skip
    clear = [(cause, side, e) for cause, side, e, b in asked if b and e.halves]
    if not clear:
        return ()
    cause, side, most = max(clear, key=lambda found: found[2].gain)
    return (
        f"what is left goes with {cause}: a regression on that foretells the error of the {side} {horizon:g} s ahead, "
        f"left-out errors are {most.in_words()} with it. {MEANS[cause]}",
    )


def _beyond_noise(each: Sequence[Astray]) -> Mask:
    """(3,) which errors are more than noise of what was measured."""
    squares = np.mean(np.concatenate([a.errors for a in each]) ** 2, axis=0)
    return squares > (EXPLAINED * np.max([a.noise for a in each], axis=0)) ** 2


def foretold(each: Sequence[Astray], horizon: float, cause: str = TOLD) -> list[Evidence]:
    """What left-out stretches of drives say of a regression on one of `MEANS`, for each of `SIDES`; nothing where there are
    fewer than are worth asking.
    """
    parts = [(k, n) for k, a in enumerate(each) for n in np.unique(a.begun // STRETCH)]
    if len(parts) < FEWEST_PARTS:
        return [Evidence(0.0, float("inf"))] * len(SIDES)
    drive = np.concatenate([np.full(len(a.begun), k) for k, a in enumerate(each)])
    begun, errors = (np.concatenate([getattr(a, n) for a in each]) for n in ("begun", "errors"))
    told = np.concatenate([a.beside[cause] for a in each])
    table = np.column_stack([np.ones(len(told)), (told - told.mean(axis=0)) / (told.std(axis=0) + TINY)])
    without, with_it = [], []
    for k, n in parts:
        left = (drive == k) & (begun // STRETCH == n)
        apart = (drive != k) | (begun < n * STRETCH - horizon) | (begun > (n + 1) * STRETCH + horizon)
        rest = errors[left] - table[left] @ _ridge(table[apart], errors[apart], horizon / EVERY)
        without.append(np.sqrt(np.mean(errors[left] ** 2, axis=0)))
        with_it.append(np.sqrt(np.mean(rest**2, axis=0)))
    return [evidence(a, b, a**2) for a, b in zip(np.transpose(without), np.transpose(with_it), strict=True)]


def moved(poses: Array) -> Array:
    """(S, 3) ahead, to the left (m) and turned (rad) from the first of poses (S, 2, 3) to the second."""
    (dx, dy, turned), psi = (poses[:, 1] - poses[:, 0]).T, poses[:, 0, 2]
    return np.stack([np.cos(psi) * dx + np.sin(psi) * dy, np.cos(psi) * dy - np.sin(psi) * dx, turned], axis=1)


def _ridge(table: Array, wanted: Array, weight: float) -> Array:
    """Least squares that count each coefficient (the first but for) as `weight` rows: as many tell the same."""
    penalty = weight * np.eye(table.shape[1])
    penalty[0, 0] = TINY
    return np.asarray(np.linalg.solve(table.T @ table + penalty, table.T @ wanted), dtype=np.float64)


def means(table: Array, starts: Integers, edges: Integers) -> Array:
    """(S, F) means of the columns of a table (G, k), a window after the other, between `edges` around the `starts`."""
    until = np.concatenate([np.zeros((1, table.shape[1])), np.cumsum(table, axis=0)])
    at = np.clip(starts[:, None] + edges[None], 0, len(table))
    means = np.diff(until[at], axis=1) / np.maximum(np.diff(at, axis=1), 1)[:, :, None]
    return means.reshape(len(starts), means.shape[1] * means.shape[2])


def cubes(pairs: Array) -> Array:
    """(T, F) both of pairs (T, 2), their products up to the third power, and the size of the second with either sign."""
    a, b = (pairs / np.maximum(np.abs(pairs).max(axis=0, initial=0.0), TINY)).T
    return np.stack([a, b, a * b, a * a, b * b, a * a * b, a * b * b, b**3, np.abs(b), a * np.abs(b)], axis=1)
