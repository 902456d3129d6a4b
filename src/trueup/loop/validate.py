# SPDX-License-Identifier: Apache-2.0
"""Does it hold on what was not fitted? Leave a recording, or a stretch of one, out, without starting over."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array
from trueup.evidence import FEWEST_PARTS
from trueup.inspection import inspect
from trueup.loop.descent import Fit
from trueup.loop.problem import Problem
from trueup.loop.uncertainty import FORETOLD, INEXACT
from trueup.recording import PART_OF, Recording, is_command
from trueup.search.bounded_step import SHORTENED, damped_step, gain
from trueup.search.robust import robust_losses, robust_weights
from trueup.verdicts import PRIOR

_STRETCH, _FEWEST, _FOLDS = 2.5, 16, 10  # s, stretches at least, sets of them that are left out in turn
_RIDGE = 1e-2  # share of what all recordings tell that holds what only the part left out has seen


@dataclass(frozen=True, eq=False)
class Block:
    """What is left out of a fit together."""

    trials: tuple[int, ...]
    rows: NDArray[np.intp]
    """Its residuals, by their place in the residual vector."""


def by_recording(problem: Problem) -> list[Block]:
    """A block for each trial; those cut from one recording are left out together, as neighbours share what is wrong.

    Where all were cut from one, each stands by itself; windows of a single recording do in stretches of some.
    """
    groups: dict[str, list[int]] = {}
    for k, owner in enumerate(problem.owners):
        recording = problem.recordings[owner]
        groups.setdefault(recording.provenance.get(PART_OF, recording.name), []).append(k)
    trials = range(len(problem.trials))
    most = _FOLDS if len(set(problem.owners)) == 1 else len(trials)
    stretches = [part.tolist() for part in np.array_split(trials, min(most, len(trials)))]
    together = list(groups.values()) if len(groups) > 1 else stretches
    return [Block(tuple(own), _rows(problem, own, 0, 1)) for own in together]


def by_stretch(problem: Problem) -> list[Block]:
    """Blocks as `by_recording`, each cut into as many stretches of time as it takes to have enough of them.

    What was recorded at rest stays whole: each stretch repeats the one beside it, and foretells it whatever is wrong.
    """
    whole = by_recording(problem)
    if len(whole) >= FEWEST_PARTS:
        return [block for block in whole if len(block.rows)]
    still = [all(_at_rest(problem.recordings[problem.owners[k]]) for k in b.trials) for b in whole]
    parts = int(np.ceil((FEWEST_PARTS - sum(still)) / max(len(whole) - sum(still), 1)))
    counts = [1 if rests else max(parts, 1) for rests in still]
    cut = [
        Block(b.trials, _rows(problem, b.trials, k, n)) for b, n in zip(whole, counts, strict=True) for k in range(n)
    ]
    return [block for block in cut if len(block.rows)]


def _at_rest(recording: Recording) -> bool:
    """Whether nothing moves in a recording, and nothing was told to."""
    found = inspect(recording).channels
    return all(set(c.motionless) == set(c.labels) for c in found if is_command(c.name) or c.name == "position")


def by_setting(problem: Problem) -> dict[str, list[Block]]:
    """Blocks of the recordings that share a setting (a gain, a load, a supply), for each that some share and not all: a
    number that all recordings name beside their signals. What holds at settings that were fitted need not hold at others.
    """
    facts = [_numbers(recording) for recording in problem.recordings]
    found: dict[tuple[tuple[int, ...], ...], str] = {}
    for name in facts[0]:
        levels = sorted({fact.get(name, np.nan) for fact in facts})
        if np.isfinite(levels).all() and 1 < len(levels) < len(facts):
            owners = list(enumerate(problem.owners))
            groups = tuple(tuple(k for k, own in owners if facts[own][name] == level) for level in levels)
            found.setdefault(groups, name)
    return {name: [Block(trials, _rows(problem, trials, 0, 1)) for trials in groups] for groups, name in found.items()}


def _numbers(recording: Recording) -> dict[str, float]:
    """The numbers that a recording names beside its signals, and those in columns that never change."""
    found = {}
    for name, text in recording.provenance.items():
        with suppress(ValueError):
            found[name] = float(text)
    for name, channel in recording.channels.items():
        single = channel.values.shape[1] == 1 and len(channel.values) > 0
        if single and not is_command(name) and np.ptp(channel.values) == 0.0:
            found[name] = float(channel.values[0, 0])
    return found


def _in_sets(blocks: Sequence[Block]) -> tuple[list[Block], NDArray[np.intp]]:
    """Blocks as they are left out of fits, in turns, and (B,) in which of these each block is: of hundreds of recordings
    tenths tell as much as each by itself (R. Kohavi, A study of cross-validation and bootstrap, IJCAI 1995).
    """
    which = np.arange(len(blocks)) % _FOLDS
    if len(blocks) <= _FOLDS:
        return list(blocks), which
    sets = [blocks[k::_FOLDS] for k in range(_FOLDS)]
    together = [
        Block(tuple(sorted({t for b in own for t in b.trials})), np.sort(np.concatenate([b.rows for b in own])))
        for own in sets
    ]
    return together, which


def left_out_points(fit: Fit, blocks: Sequence[Block], held: Array | None = None, *, settled: bool = False) -> Array:
    """(B, n_free) where the fit would go if it had never seen each block: one Gauss-Newton step from the optimum.

    `held` (n_free,) are values in the unit box for parameters that must not be used, NaN for the others. `settled`: where
    the fit ended is taken for the optimum, whatever slopes there still promise.
    """
    weighted = fit.jacobian * fit.weights[:, None]
    given = fit.unit if held is None else np.where(np.isfinite(held), held, fit.unit)
    free = np.ones(len(fit.unit), dtype=bool) if held is None else ~np.isfinite(held)
    jump = given - fit.unit
    curvature = fit.jacobian.T @ weighted
    slope = np.zeros(len(fit.unit)) if settled else weighted.T @ fit.residual
    ridge = _RIDGE * np.diag(np.diag(curvature)[free]) + PRIOR * np.eye(int(free.sum()))
    points = np.tile(given, (len(blocks), 1))
    for point, block in zip(points, blocks, strict=True):
        own = block.rows
        left = curvature - fit.jacobian[own].T @ weighted[own]
        pull = slope - weighted[own].T @ fit.residual[own] + left @ jump
        step = -np.linalg.solve(left[np.ix_(free, free)] + ridge, pull[free])
        point[free] += np.clip(step, -FORETOLD, FORETOLD)
    return np.clip(points, 0.0, 1.0)


def backtracked(
    problem: Problem, fit: Fit, blocks: Sequence[Block], held: Array | None = None, *, settled: bool = False
) -> tuple[Array, Array]:
    """As `left_out_points`, each step cut short until it lowers the loss of all that is not left out, or given up, and the
    residuals (B, m) there: slopes of gaps and limits foretell little (backtracking: Nocedal and Wright, Numerical
    Optimization, 2006, section 3.1).
    """
    start = fit.unit if held is None else np.where(np.isfinite(held), held, fit.unit)
    steps = left_out_points(fit, blocks, held, settled=settled) - start
    begun = problem.residuals(fit.space.from_unit(start[None]))[0]
    points, residuals = np.tile(start, (len(blocks), 1)), np.tile(begun, (len(blocks), 1))
    left = list(range(len(blocks)))
    for share in SHORTENED:
        tried = np.clip(start + share * steps[left], 0.0, 1.0)
        came = problem.residuals(fit.space.from_unit(tried)) if left else residuals[:0]
        lower = [_lower(row, begun, blocks[b], fit.bend) for b, row in zip(left, came, strict=True)]
        done = [b for b, is_lower in zip(left, lower, strict=True) if is_lower]
        points[done], residuals[done] = tried[lower], came[lower]
        left = [b for b in left if b not in done]
    return points, residuals


def _lower(residual: Array, begun: Array, block: Block, bend: float) -> bool:
    """Whether residuals (m,) have less loss than those `begun` with in all that is not left out."""
    losses = robust_losses(np.delete([residual, begun], block.rows, axis=1), bend)
    after, before = np.nan_to_num(losses, nan=np.inf)
    return bool(after < before)


def settled_loss(fit: Fit, others: NDArray[np.intp], residual: Array, rows: NDArray[np.intp] | None = None) -> float:
    """The loss of residuals (r,), all or in some rows, once other parameters have settled, by the slopes of a fit."""
    if not np.isfinite(residual).all():
        return float("inf")
    curvature, slope, step = settling(fit, others, residual, rows)
    return float(robust_losses(residual[None], fit.bend)[0]) - gain(curvature, slope, step)


def settling(
    fit: Fit, others: NDArray[np.intp], residual: Array, rows: NDArray[np.intp] | None = None
) -> tuple[Array, Array, Array]:
    """Curvature (k, k) and slope (k,) of the loss of residuals (r,) in other parameters, and the step (k,) in which they
    settle, by the slopes of a fit.
    """
    jacobian = fit.jacobian[:, others] if rows is None else fit.jacobian[np.ix_(rows, others)]
    root = np.sqrt(robust_weights(residual, fit.bend))
    jacobian *= root[:, None]  # a copy, as its columns were picked
    curvature, slope = jacobian.T @ jacobian, jacobian.T @ (root * residual)
    step = damped_step(curvature, slope, INEXACT, fit.unit[others]) if len(others) else np.zeros(0)
    return curvature, slope, step


def folds(problem: Problem) -> tuple[list[Block], NDArray[np.intp]]:
    """Blocks of many short stretches each, taken in turns all over the recordings, and (m,) the number of the stretch and
    label of each residual: what is seen in few seconds only (a limit that is met, the fast end of a chirp) can be foretold
    from the stretches beside.
    """
    every, cells, turns = range(len(problem.trials)), [], []
    longest = min(_STRETCH, problem.duration / _FEWEST)
    for segment in problem.segments:
        count = max(1, round(problem.trials[segment.trial].duration / longest))
        stretch = np.minimum(np.arange(segment.samples) * count // max(segment.samples, 1), count - 1)
        own = np.stack(np.broadcast_arrays(stretch[:, None], np.arange(len(segment.labels))), axis=-1)[segment.mask]
        first = 0 if not cells else int(cells[-1].max()) + 1
        cells.append(first + own[:, 0] * len(segment.labels) + own[:, 1])
        turns.append((own[:, 0] + segment.trial) % _FOLDS)
    turn = np.concatenate(turns)
    blocks = [Block(tuple(every), np.flatnonzero(turn == k)) for k in range(_FOLDS)]
    return [block for block in blocks if len(block.rows)], np.concatenate(cells)


def foretold(problem: Problem, fit: Fit) -> Array:
    """(cells,) root mean square, in noise units, of each label of each stretch of `folds` by a fit that never saw it.

    For searches that are still on their way: where they are counts as settled. Steps go no further than all that is not
    left out bears them out; inf where the replay fails.
    """
    blocks, cells = folds(problem)
    _, residuals = backtracked(problem, fit, blocks, settled=True)
    squares = np.empty(len(cells))
    for block, residual in zip(blocks, residuals, strict=True):
        squares[block.rows] = residual[block.rows] ** 2
    squares[~np.isfinite(squares)] = np.inf
    return np.sqrt(np.bincount(cells, squares) / np.maximum(np.bincount(cells), 1))


def left_out_errors(problem: Problem, fit: Fit, blocks: Sequence[Block], held: Array | None = None) -> Array:
    """(B,) replay error of each block by a fit that never saw it, as `block_errors` has it; `held` as `left_out_points`."""
    sets, which = _in_sets(blocks)
    return block_errors(problem, blocks, fit.space.from_unit(left_out_points(fit, sets, held))[which])


def cautious_errors(problem: Problem, fit: Fit, blocks: Sequence[Block], held: Array | None = None) -> Array:
    """As `left_out_errors`, by fits that go no further than all that they saw bears them out."""
    sets, which = _in_sets(blocks)
    return block_errors(problem, blocks, fit.space.from_unit(backtracked(problem, fit, sets, held)[0])[which])


def block_errors(problem: Problem, blocks: Sequence[Block], values: Array) -> Array:
    """(B,) replay error of each block with values (B, n) of its own, in the main channel's unit.

    inf where the replay fails, NaN for a block without the main channel.
    """
    name = problem.main[0]
    main = np.concatenate([np.full(s.count, s.channel == name) for s in problem.segments])
    units = np.concatenate([s.units for s in problem.segments])
    errors, rows = np.full(len(blocks), np.nan), [block.rows[main[block.rows]] for block in blocks]
    each, of = np.unique(values, axis=0, return_inverse=True)
    waiting = [[b for b in np.flatnonzero(of.ravel() == k).tolist() if len(rows[b])] for k in range(len(each))]
    while waiting:  # blocks with the same values are simulated at once
        if not (own := waiting.pop()):
            continue
        trials = sorted({t for b in own for t in blocks[b].trials})
        residual = problem.residuals(values[own[:1]], only=trials)[0]
        if len(own) > 1 and not np.isfinite(residual).all():  # one that fails says nothing of the others
            waiting += [[b] for b in own]
            continue
        places = _rows(problem, trials, 0, 1)
        for b in own:
            error = float(np.sqrt(np.mean((residual[np.searchsorted(places, rows[b])] * units[rows[b]]) ** 2)))
            errors[b] = error if np.isfinite(error) else np.inf
    return errors


def _rows(problem: Problem, trials: Sequence[int], part: int, parts: int) -> NDArray[np.intp]:
    """Places of the residuals of one of several stretches of time of these trials."""
    rows, among = [], set(trials)
    for segment in problem.segments:
        if segment.trial in among:
            first, last = (round(segment.samples * p / parts) for p in (part, part + 1))
            inside = np.zeros((segment.samples, len(segment.labels)), dtype=bool)
            inside[first:last] = True
            rows.append(segment.columns.start + np.flatnonzero(inside[segment.mask]))
    return np.concatenate(rows)
