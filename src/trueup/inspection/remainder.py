# SPDX-License-Identifier: Apache-2.0
"""Whether what a calibrated vehicle is predicted wrong by goes with what it was told: then its structure is another one.

No list of vehicles is looked through (trailers, rear wheels that steer, tyres that scrub): a regression without any structure
is asked, and has to foretell what it did not see. The same is asked of how long the vehicle has driven (a battery that
empties), of which way it faces (a floor that slopes) and of where it is (hills).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.evidence import FEWEST_PARTS, HALVED, Evidence, evidence
from trueup.rounding import ROUNDED, TINY
from trueup.tracking.windows import LENGTH

EVERY = 0.25
"""In s between predictions."""
SIDES = ("position along the vehicle", "position across the vehicle", "heading")
_ENOUGH = 300  # places of which a map of errors is made: the work grows with their cube, and drives come by again
TOLD, DRIVEN, FACED = "what was commanded", "how long the vehicle had driven", "which way the vehicle faced"
PLACED = "where the vehicle was"
SIGNALS = (
    "the commanded speed or throttle",
    "the commanded steering or turn rate",
    "how fast it went",
    "how fast it turned",
)
"""What TOLD is made of."""
MEANS = {
    TOLD: "The vehicle moves in a way that the simulated one cannot (as with a trailer, with wheels that steer or slip "
    "otherwise, or with something else that was commanded and is not in the mapping), and values found for it make up for "
    "that",
    DRIVEN: "Something changes while it drives that the simulated one keeps (as where a battery empties, or motors and tyres "
    "get warm), and values found for it are those of a mean of the drives",
    FACED: "Something of the place acts on it that the simulated one does not know (as on a floor that slopes, or in wind), "
    "and values found for it make up for that",
    PLACED: "Something of the place acts on it that the simulated one does not know (as hills, or a floor that grips "
    "otherwise in places), and values found for it make up for that",
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
    of the heading; x and y (m), heading (rad) and the way driven (m) in the middle of what is judged.
    """
    alone: Mapping[str, Array]
    """(S, F) of each of `SIGNALS` by itself."""


def unlike(each: Sequence[Astray], horizon: float) -> tuple[str, ...]:
    """What to say of drives whose errors `horizon` s ahead a regression foretells, on what does so best: nothing where
    left-out errors do not become half as large, by the rule of evidence. One signal is named in place of all of them where it
    does as well, within a standard error (L. Breiman et al., 1984, section 3.4.3).
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
    most_with = _most_with(each, horizon, cause, side, most)
    return (
        f"{_size(each, side, horizon)}, and that goes with {cause}{most_with}: a regression on that foretells it, left-out "
        f"errors are {most.in_words()} with it. {MEANS[cause]}",
    )


def unexplained(each: Sequence[Astray], horizon: float) -> tuple[str, ...]:
    """What to say of drives whose errors `horizon` s ahead are beyond noise and go with nothing that `unlike` asks about: how
    large the one is that is so by most.
    """
    if not each or not _beyond_noise(each).any():
        return ()
    sizes = _sizes(each)
    side = SIDES[int(np.argmax(sizes[0] / sizes[1]))]
    asked = f"A regression on none of these halves it: {', '.join(MEANS)}"
    if _stretches(each) < FEWEST_PARTS:
        asked = "Too little was driven to ask what it goes with: a minute and more would tell"
    return (
        f"{_size(each, side, horizon)}. {asked}. A vehicle that moves otherwise, gusts, a floor that is not alike, commands "
        "that are not in the log or a pose that drifts may be behind it: expect predictions to be off by as much",
    )


def _stretches(each: Sequence[Astray]) -> int:
    """How many stretches can be left out in turn."""
    return sum(len(np.unique(a.begun // LENGTH)) for a in each)


def _sizes(each: Sequence[Astray]) -> Array:
    """(2, 3) root mean squares of what is left of `SIDES`, and what noise of the poses makes of them."""
    left = np.sqrt(np.mean(np.concatenate([a.errors for a in each]) ** 2, axis=0))
    return np.stack([left, np.maximum(np.max([a.noise for a in each], axis=0), TINY)])


def _size(each: Sequence[Astray], side: str, horizon: float) -> str:
    """How much is left of one of `SIDES`."""
    size, noise = _sizes(each)[:, SIDES.index(side)].tolist()
    unit = "rad" if side == "heading" else "m"
    return (
        f"what is left of the {side} in the second half of predictions {horizon:g} s ahead is {size:.2g} {unit} (root mean "
        f"square), {size / noise:.2g} times what noise makes it"
    )


def _most_with(each: Sequence[Astray], horizon: float, cause: str, side: str, most: Evidence) -> str:
    """The one of `SIGNALS` with which errors go as well as with all that was commanded; '' for none."""
    if cause != TOLD:
        return ""
    k = SIDES.index(side)
    alone = {name: foretold(each, horizon, name)[k] for name in SIGNALS}
    best = max(alone, key=lambda name: alone[name].gain)
    enough = alone[best].holds and alone[best].gain > most.gain - most.standard_error
    return f", most of all with {best}" if enough else ""


def _beyond_noise(each: Sequence[Astray]) -> Mask:
    """(3,) which errors are more than noise of what was measured."""
    left, noise = _sizes(each)
    return np.asarray(HALVED * left > noise)


def foretold(each: Sequence[Astray], horizon: float, cause: str = TOLD) -> list[Evidence]:
    """What left-out stretches of drives say of a regression on one of `MEANS` or of `SIGNALS`, for each of `SIDES`; nothing
    where there are fewer than are worth asking.
    """
    told = np.concatenate([a.alone[cause] if cause in a.alone else a.beside[cause] for a in each])
    if cause != PLACED:
        return _left_out(each, horizon, (told - told.mean(axis=0)) / (told.std(axis=0) + TINY))
    # Predictions that tell the same are left out together, passes by a place are not: each counts as one.
    alike = np.sqrt(horizon / EVERY)
    return _left_out(each, horizon, alike * _over_places(told))


def _left_out(each: Sequence[Astray], horizon: float, told: Array) -> list[Evidence]:
    """The evidence of a ridge regression on columns of `told` (S, F)."""
    parts = [(k, n) for k, a in enumerate(each) for n in np.unique(a.begun // LENGTH)]
    if len(parts) < FEWEST_PARTS:
        return [Evidence(0.0, float("inf"))] * len(SIDES)
    drive = np.concatenate([np.full(len(a.begun), k) for k, a in enumerate(each)])
    begun, errors = (np.concatenate([getattr(a, n) for a in each]) for n in ("begun", "errors"))
    table = np.column_stack([np.ones(len(told)), told])
    without, with_it = [], []
    for k, n in parts:
        left = (drive == k) & (begun // LENGTH == n)
        apart = (drive != k) | (begun < n * LENGTH - horizon) | (begun > (n + 1) * LENGTH + horizon)
        rest = errors[left] - table[left] @ _ridge(table[apart], errors[apart], horizon / EVERY)
        without.append(np.sqrt(np.mean(errors[left] ** 2, axis=0)))
        with_it.append(np.sqrt(np.mean(rest**2, axis=0)))
    return [evidence(a, b, a**2) for a, b in zip(np.transpose(without), np.transpose(with_it), strict=True)]


def _over_places(places: Array) -> Array:
    """(S, F) features on which a ridge is a Gaussian process over places (x, y, heading, way): what is the same for all who
    come by, and what turns round with the heading, as a slope does. It is smooth over the way in which errors arise: an error
    is the mean of less, and of more, drives that pass far beside one another tell as much. C. Rasmussen, C. Williams,
    Gaussian Processes for Machine Learning, 2006, sections 2.1 and 8.1 (of some places).
    """
    some = places[:: int(np.ceil(len(places) / _ENOUGH))]
    length = max(float(np.mean(places[:, 3])), TINY)
    values, vectors = np.linalg.eigh(_alike(some, some, length))
    kept = values > ROUNDED * values[-1]
    return np.asarray(_alike(places, some, length) @ (vectors[:, kept] / np.sqrt(values[kept])), dtype=np.float64)


def _alike(places: Array, others: Array, length: float) -> Array:
    """(S, M) covariances of places (S, 4) and others (M, 4)."""
    (x, y, psi, _), (u, v, chi, _) = places.T, others.T
    apart = (x[:, None] - u) ** 2 + (y[:, None] - v) ** 2
    return np.asarray(np.exp(-0.5 * apart / length**2) * (1.0 + np.cos(psi[:, None] - chi)), dtype=np.float64)


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


def powers(signal: Array) -> Array:
    """(T, 4) of a signal (T,): it, its square, its cube and its size."""
    a = signal / max(float(np.abs(signal).max(initial=0.0)), TINY)
    return np.stack([a, a * a, a**3, np.abs(a)], axis=1)


def cubes(pairs: Array) -> Array:
    """(T, F) both of pairs (T, 2), their products up to the third power, and the size of the second with either sign."""
    a, b = (pairs / np.maximum(np.abs(pairs).max(axis=0, initial=0.0), TINY)).T
    return np.stack([a, b, a * b, a * a, b * b, a * a * b, a * b * b, b**3, np.abs(b), a * np.abs(b)], axis=1)
