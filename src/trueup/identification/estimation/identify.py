# SPDX-License-Identifier: Apache-2.0
"""A model file and logs in, a dynamic model that predicts torque out: the sentence that joins this folder."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Literal

import numpy as np

from trueup.arrays import Array
from trueup.errors import IdentificationError
from trueup.identification.estimation.alignment import find_shift, shifted
from trueup.identification.estimation.beside_file import beside_file
from trueup.identification.estimation.blocks import blocks_of, numbered
from trueup.identification.estimation.bodies import Bodies, cross_validated_fit
from trueup.identification.estimation.couplings import confirmed, coupled, coupling_notes
from trueup.identification.estimation.cutoff import natural_cutoff
from trueup.identification.estimation.diagnosis import check_log, grouped
from trueup.identification.estimation.disturbed import without_disturbed
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.estimate import (
    Estimate,
    least_squares,
    weighted_least_squares,
    with_doubtful_torque,
)
from trueup.identification.estimation.file_fit import FileFit, file_fit
from trueup.identification.estimation.matching import matched
from trueup.identification.estimation.moments import Moments, moments_of
from trueup.identification.estimation.motion import Log, Motion, Piece, log_of, pieces_of
from trueup.identification.estimation.outcome import outcome
from trueup.identification.estimation.pool import (
    STRUCTURES,
    Pool,
    kinds_of,
    nominal_of,
    pool_for,
    select_structure,
    with_load_columns,
)
from trueup.identification.estimation.quick import basic_columns, doubts, measured_speed
from trueup.identification.estimation.result import Alignment, Identification
from trueup.identification.estimation.selection import (
    TIME_BLOCKS,
    Choice,
    cross_validated,
    select_pull,
    select_shrinkage,
)
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.rows import Rows
from trueup.inspection.diagnosis import check_refused
from trueup.inspection.outstanding import NAME
from trueup.recording import Recording

Told = Callable[[str, float], None]
Structured = tuple[list[Piece], Array, Moments, Choice]
"""Pieces with their effects of load, the links (n, 10) that these were made of, moments, the model that predicts best."""
Modelled = tuple[Pool, Array, Alignment | None, Structured]
"""The pool, what the file says (p,), the shift in time, and the model."""

_STAGES = (
    "reading the logs", "computing regressors", "comparing clocks",
    "choosing the structure of friction", "estimating", "writing",
)  # fmt: skip


@dataclass(frozen=True)
class Options:
    """How to identify; the defaults decide by the data."""

    cutoff: float | None = None
    """Hz; None takes it from the motion."""
    align: Literal["auto", "off"] | float = "auto"
    """Torque against position: 'auto' corrects a shift that is certain, a number of s is taken as it is."""
    hold_out: float = 0.0
    """Share of each recording, at its end, that is not fitted."""
    structure: str = "select"
    """'select', 'paper' or 'common', see pool.select_structure."""
    robust: bool | None = None
    """Whether to weigh outliers down; None decides by their share."""
    consistent: bool = True
    gains: bool = False
    """Whether each joint may have a scale of its own where logs hold torque in N m; where they do not, it may anyway."""
    torque: str = ""
    """Which torque is fitted where logs hold several, see torque_choice."""
    refuse: tuple[str, ...] = ()
    """'disturbed': stretches in which something acted on the arm are fitted and judged like all others."""
    seed: int = 0


def identify(
    tree: KinematicTree, training: Sequence[Recording], held_out: Sequence[Recording] = (), *, drives: Drives | None = None,
    options: Options | None = None, told: Told | None = None,
) -> Identification:  # fmt: skip
    """The dynamic model of `tree` from recordings of position and torque (or current), judged on what was held out.

    Columns become joints by name, joints that no log has are locked (`matched`): `found.model.tree` is what was identified.
    Raises IdentificationError and UnknownNameError, naming the recording and what to do, for logs that cannot be used.
    """
    started, wanted, say = time.perf_counter(), options or Options(), _stage_reporter(told)
    _check_options(wanted, training)
    say("reading the logs")
    tree, (training, held_out), told_by_names = matched(tree, (list(training), list(held_out)), wanted.torque)
    gears, rng = drives.only(tree.joints) if drives else Drives.direct(tree.joints), np.random.default_rng(wanted.seed)
    logs, judged = ([log_of(r, tree, gears) for r in group] for group in (training, held_out))
    warnings = [*told_by_names, *_minded(logs, judged, tree)]
    logs, judged, alone = without_disturbed(logs, judged, tree, gears, refused=NAME in wanted.refuse)
    cutoff = wanted.cutoff or natural_cutoff(logs)
    measured = measured_speed(logs, tree, gears, cutoff, wanted.hold_out)
    say("computing regressors")
    motions, others = ([log.motion(cutoff, measured_speed=measured) for log in group] for group in (logs, judged))
    # What scales measured torque compensates something else: a pull towards the file, or friction of another form.
    scaled = wanted.gains or not all(log.measured for log in logs)
    prepared = cache(
        partial(_compared, tree, motions, others, rate=logs[0].rate, cutoff=cutoff, scaled=scaled, wanted=wanted)
    )
    model = cache(lambda drives: prepared(drives).model())
    coupling = coupled(motions, tree, gears, cutoff, wanted.hold_out)
    say("comparing clocks")
    warnings += [*alone, *doubts(logs, tree, coupling, prepared(coupling).pool, prepared(coupling).aligned)]
    warnings += beside_file(logs, tree)
    say("choosing the structure of friction")
    coupling = confirmed(coupling, gears, cache(lambda drives: _left_out(model(drives))))
    warnings += coupling_notes(coupling, gears)
    pool, nominal, alignment, (pieces, carried, moments, choice) = model(coupling)
    say("estimating")
    estimate, bodies, written, choice = _estimated(pool, pieces, nominal, choice, wanted)
    if coupling.doubts is not None:
        estimate = with_doubtful_torque(estimate, _training(pieces), coupling.doubts)
    say("writing")
    return outcome(
        tree, pool, choice, estimate, bodies and bodies.fit, written, pieces, alignment, carried=carried, moments=moments,
        nominal=nominal, units=logs[0].units, pull=bodies.pull if bodies else 0.0, cutoff=cutoff, warnings=warnings, rng=rng,
        started=started,
    )  # fmt: skip


def _left_out(modelled: Modelled) -> tuple[Choice, ...]:
    """The model with its errors on blocks of time that were left out, and on kinds of motion."""
    pool, nominal, _, (pieces, _, _, choice) = modelled
    kinds = moments_of(kinds_of(pool, pieces))
    return choice, *cross_validated(kinds, pool.prior(nominal) * kinds.scale, choice)


@dataclass(frozen=True, eq=False)
class _Compared:
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


def _compared(
    tree: KinematicTree, motions: Sequence[Motion], judged: Sequence[Motion], drives: Drives, *, rate: float, cutoff: float,
    scaled: bool, wanted: Options,
) -> _Compared:  # fmt: skip
    """Motions beside every effect of these drives, their clocks compared; `rate` is that of the logs in Hz, `scaled` whether
    joints may have a scale of their own.
    """
    pool = pool_for(tree, drives.coupling, motions, gains=scaled)
    pieces = [p for m in motions for p in pieces_of(m, pool.model, cutoff, wanted.hold_out)]
    pieces += [replace(p, held_out=True) for m in judged for p in pieces_of(m, pool.model, cutoff, 0.0)]
    alignment, aligned = _aligned(pool, pieces, rate, wanted.align)
    return _Compared(pool, alignment, aligned, pieces, cutoff, wanted.structure)


def _minded(logs: Sequence[Log], judged: Sequence[Log], tree: KinematicTree) -> list[str]:
    """What to mind in logs that are fitted and in those that only judge, what is alike once."""
    groups = ((logs, False), (judged, True))
    return grouped(n for group, j in groups for x in group for n in (*x.notes, *check_log(x, tree, judged=j)))


def _stage_reporter(told: Told | None) -> Callable[[str], None]:
    """Tells a stage, with the share of stages that are over."""

    def say(stage: str) -> None:
        if told is not None:
            told(stage, _STAGES.index(stage) / len(_STAGES))

    return say


def _structured(pool: Pool, pieces: Sequence[Piece], nominal: Array, structure: str, margin: float) -> Structured:
    """The pieces with their effects of load, and the model that predicts best; what gears carry is that of a rough fit."""
    prior = pool.prior(nominal)
    rough = weighted_least_squares(_training(pieces), basic_columns(pool), prior=prior).parameters
    links = pool.carried_links(rough)
    made = with_load_columns(pool, pieces, links)
    moments = moments_of(_blocks(made, margin))
    choice = select_structure(pool, moments, prior * moments.scale, structure)
    if structure == "select":
        moments, choice, left = select_shrinkage(moments, lambda: moments_of(kinds_of(pool, made)), prior, choice)
        made = [replace(p, rows=p.rows.with_shrinkage(left)) for p in made]
    return made, links, moments, choice


def _select_alignment(
    alignment: Alignment | None, aligned: Sequence[Piece], as_logged: Sequence[Piece],
    structured: Callable[[Sequence[Piece]], Structured],
) -> tuple[Alignment | None, Structured]:  # fmt: skip
    """The model with a shift of torque in time taken out, unless richer friction explains as well what looked like one."""
    shifted_model = structured(aligned)
    if alignment is None or not alignment.corrected:
        return alignment, shifted_model
    plain = structured(as_logged)
    if shifted_model[-1].beats(plain[-1]):
        return alignment, shifted_model
    return replace(alignment, corrected=False), plain


def _training(pieces: Sequence[Piece]) -> list[Rows]:
    return [p.rows for p in pieces if not p.held_out]


def _blocks(pieces: Sequence[Piece], margin: float) -> list[Rows]:
    """What is fitted, in blocks of motion that is not repeated in others, `margin` s left out at their ends."""
    rows = _training(pieces)
    return blocks_of(rows, numbered(rows, TIME_BLOCKS, [p.motion.q for p in pieces if not p.held_out]), margin)


def _estimated(
    pool: Pool, pieces: Sequence[Piece], nominal: Array, choice: Choice, wanted: Options
) -> tuple[Estimate, Bodies | None, FileFit | None, Choice]:
    """The estimate, drawn to possible bodies as far as that predicts no worse, those bodies, what a model file can hold, and
    how strongly the estimate is drawn.
    """
    active, parts = np.flatnonzero(choice.active), _training(pieces)

    def fit(prior: Array, strength: float, robust: bool | None) -> Estimate:
        return least_squares(parts, active, choice.weights, prior=prior, strength=strength, robust=robust)

    free = fit(pool.prior(nominal), choice.strength, wanted.robust)
    if not wanted.consistent:
        return free, None, None, choice
    # All samples, where the choice of the structure left out those at the borders of blocks.
    moments = moments_of(_blocks(pieces, 0.0))
    lag = wanted.structure == "select"
    bodies = cross_validated_fit(pool.model, moments, choice.weights, active, nominal, lag=lag)
    written = file_fit(pool, moments, nominal, bodies.pull, [p.motion.v for p in pieces if not p.held_out])
    if len(bodies.folds) < 2:
        return free, bodies, written, choice

    def judged(k: int) -> tuple[Moments, Array]:
        of = moments_of(kinds_of(pool, pieces)) if k else moments
        return of, of.scale * [pool.prior(fold.parameters) for fold in (bodies.without(of) if k else bodies.folds)]

    choice = select_pull(judged, choice)
    near = fit(pool.prior(bodies.fit.parameters), choice.strength, free.robust)
    # Deviations: what the logs tell by themselves.
    return replace(near, covariance=free.covariance), bodies, written, choice


def _check_options(options: Options, training: Sequence[Recording]) -> None:
    if not training:
        raise IdentificationError("no recording is left to fit: all are held out")
    if options.structure not in STRUCTURES:
        raise IdentificationError(
            f"friction structure '{options.structure}' is unknown; choices: {', '.join(STRUCTURES)}"
        )
    if not 0.0 <= options.hold_out < 0.9:
        raise IdentificationError(f"a share of {options.hold_out:g} cannot be held out; give 0 to 0.9")
    check_refused(options.refuse, (NAME,))
    if options.cutoff is not None and not options.cutoff > 0.0:
        raise IdentificationError(f"a cut-off of {options.cutoff:g} Hz is not above zero")


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
