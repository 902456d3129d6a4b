# SPDX-License-Identifier: Apache-2.0
"""The model of torque that predicts best what its fit did not see, for one coupling of the drives and one way of gravity."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from trueup.arrays import Array
from trueup.identification.estimation.alignment import find_shift, shifted
from trueup.identification.estimation.blocks import blocks_of, numbered
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.estimate import least_squares, weighted_least_squares
from trueup.identification.estimation.moments import Moments, moments_of
from trueup.identification.estimation.motion import Motion, Piece, pieces_of
from trueup.identification.estimation.pool import (
    Pool,
    kinds_of,
    nominal_of,
    pool_for,
    select_structure,
    with_load_columns,
)
from trueup.identification.estimation.quick import basic_columns
from trueup.identification.estimation.result import Alignment
from trueup.identification.estimation.selection import TIME_BLOCKS, Choice, cross_validated, select_shrinkage
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.rows import Rows

Structured = tuple[list[Piece], Array, Moments, Choice]
"""Pieces with their effects of load, the links (n, 10) that these were made of, moments, the model that predicts best."""
Modelled = tuple[Pool, Array, Alignment | None, Structured]
"""The pool, what the file says (p,), the shift in time, and the model."""


def left_out(modelled: Modelled) -> tuple[Choice, ...]:
    """The model with its errors on blocks of time that were left out, and on kinds of motion."""
    pool, nominal, _, (pieces, _, _, choice) = modelled
    kinds = moments_of(kinds_of(pool, pieces))
    return choice, *cross_validated(kinds, pool.prior(nominal) * kinds.scale, choice)


@dataclass(frozen=True, eq=False)
class Prepared:
    """Torque beside the columns of a pool, for one coupling of the drives."""

    pool: Pool
    alignment: Alignment | None
    aligned: Sequence[Piece]
    as_logged: Sequence[Piece]
    cutoff: float
    structure: str

    def model(self) -> Modelled:
        """The model that predicts best."""
        nominal = nominal_of(self.pool.model)
        structured = partial(
            _structured, self.pool, nominal=nominal, structure=self.structure, margin=1.0 / self.cutoff
        )
        return self.pool, nominal, *_select_alignment(self.alignment, self.aligned, self.as_logged, structured)


def prepare(
    tree: KinematicTree, drives: Drives, *, motions: Sequence[Motion], judged: Sequence[Motion], rate: float, cutoff: float,
    scaled: bool, align: str | float,
    hold_out: float, structure: str,
) -> Prepared:  # fmt: skip
    """Motions beside every effect of these drives, their clocks compared; `rate` is that of the logs in Hz, `scaled` whether
    joints may have a scale of their own; the others as in `Options`.
    """
    pool = pool_for(tree, drives.coupling, motions, gains=scaled, springs=drives.springs)
    pieces = [p for m in motions for p in pieces_of(m, pool.model, cutoff, hold_out)]
    pieces += [replace(p, held_out=True) for m in judged for p in pieces_of(m, pool.model, cutoff, 0.0)]
    alignment, aligned = _aligned(pool, pieces, rate, align)
    return Prepared(pool, alignment, aligned, pieces, cutoff, structure)


def _structured(pool: Pool, pieces: Sequence[Piece], nominal: Array, structure: str, margin: float) -> Structured:
    """The pieces with their effects of load, and the model that predicts best; what gears carry is that of a rough fit."""
    prior = pool.prior(nominal)
    rough = weighted_least_squares(fitted_rows(pieces), basic_columns(pool), prior=prior).parameters
    links = pool.carried_links(rough)
    made = with_load_columns(pool, pieces, links)
    moments = moments_of(fitted_blocks(made, margin))
    choice = select_structure(pool, moments, prior * moments.scale, structure)
    if structure == "select":
        moments, choice, left = select_shrinkage(moments, lambda: moments_of(kinds_of(pool, made)), prior, choice)
        made = [replace(p, rows=p.rows.with_shrinkage(left)) for p in made]
    return made, links, moments, choice


def _select_alignment(
    alignment: Alignment | None, aligned: Sequence[Piece], as_logged: Sequence[Piece],
    structured: Callable[[Sequence[Piece]], Structured],
) -> tuple[Alignment | None, Structured]:  # fmt: skip
    """The model with a shift of torque in time taken out, unless richer friction explains as well what looked like one; then
    with what of a shift is certain beside that friction.
    """
    model = structured(aligned)
    if alignment is None or alignment.deviation == 0.0:  # none is asked for, or that which was given
        return alignment, model
    if not alignment.corrected:
        return _beside(alignment, model, 0.0), model
    plain = structured(as_logged)
    if model[-1].beats(plain[-1]):
        return _beside(alignment, model, alignment.shift), model
    found = _beside(alignment, plain, 0.0)
    if not found.corrected:
        return found, plain
    return found, structured([replace(p, rows=shifted(p.rows, found.shift)) for p in as_logged])


def _beside(alignment: Alignment, model: Structured, taken: float) -> Alignment:
    """The shift beside the columns of a model, of whose torque a shift of `taken` s is taken out already."""
    pieces, _, _, choice = model
    rest = find_shift(fitted_rows(pieces), np.flatnonzero(choice.active), choice.weights, alignment.rate)
    if taken:
        return replace(alignment, deviation=rest.deviation)
    return replace(rest, corrected=alignment.corrected and rest.corrected)


def fitted_rows(pieces: Sequence[Piece]) -> list[Rows]:
    """What is fitted."""
    return [p.rows for p in pieces if not p.held_out]


def as_trusted(pieces: Sequence[Piece], trust: Sequence[Array] | None) -> list[Piece]:
    """The pieces, each sample of those that are fitted with as much weight as `trust` (S, n) gives it."""
    if trust is None:
        return list(pieces)
    given = iter(trust)
    return [p if p.held_out else replace(p, rows=p.rows.scaled(np.sqrt(next(given)))) for p in pieces]


def fitted_blocks(pieces: Sequence[Piece], margin: float) -> list[Rows]:
    """What is fitted, in blocks of motion that is not repeated in others, `margin` s left out at their ends."""
    rows = fitted_rows(pieces)
    return blocks_of(rows, numbered(rows, TIME_BLOCKS, [p.motion.q for p in pieces if not p.held_out]), margin)


def _aligned(
    pool: Pool, pieces: Sequence[Piece], rate: float, align: str | float
) -> tuple[Alignment | None, list[Piece]]:
    """Pieces with a shift of their torque taken out, where it is asked for or certain."""
    if align == "off":
        return None, list(pieces)
    if isinstance(align, str):
        parts = [p.rows for p in pieces if not p.held_out]
        basic = basic_columns(pool)
        weights = least_squares(parts, basic).noise ** -2.0
        found = find_shift(parts, basic, weights / weights.mean(), rate)
    else:
        found = Alignment(float(align), 0.0, rate, True, float("nan"))
    if not found.corrected:
        return found, list(pieces)
    return found, [replace(p, rows=shifted(p.rows, found.shift)) for p in pieces]
