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
from trueup.identification.estimation.alignment import with_doubtful_clock
from trueup.identification.estimation.beside_file import beside_file
from trueup.identification.estimation.bodies import Bodies, cross_validated_fit
from trueup.identification.estimation.couplings import confirmed, coupled, coupling_notes
from trueup.identification.estimation.cutoff import natural_cutoff
from trueup.identification.estimation.diagnosis import check_log, grouped
from trueup.identification.estimation.disturbed import without_disturbed
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.estimate import (
    Estimate,
    least_squares,
    with_doubtful_torque,
    with_missed_form,
)
from trueup.identification.estimation.file_fit import FileFit, file_fit
from trueup.identification.estimation.leaning import NAME as LEAN
from trueup.identification.estimation.leaning import as_it_leans
from trueup.identification.estimation.matching import matched
from trueup.identification.estimation.modelled import (
    Prepared,
    as_trusted,
    fitted_blocks,
    fitted_rows,
    left_out,
    prepare,
)
from trueup.identification.estimation.moments import Moments, moments_of
from trueup.identification.estimation.motion import Log, Motion, Piece, log_of
from trueup.identification.estimation.outcome import outcome
from trueup.identification.estimation.pool import (
    STRUCTURES,
    Pool,
    kinds_of,
)
from trueup.identification.estimation.quick import doubts, measured_speed
from trueup.identification.estimation.result import Alignment, Identification
from trueup.identification.estimation.scales import own_scales
from trueup.identification.estimation.selection import (
    Choice,
    select_pull,
)
from trueup.identification.estimation.warming import changed_friction
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.rows import Rows
from trueup.inspection.diagnosis import check_refused
from trueup.inspection.outstanding import NAME
from trueup.recording import Recording

Told = Callable[[str, float], None]
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
    robust: bool = True
    """Whether to weigh outliers down."""
    consistent: bool = True
    gains: bool = False
    """Whether each joint may have a scale of its own where logs hold torque in N m; where they do not, it may anyway."""
    torque: str = ""
    """Which torque is fitted where logs hold several, see torque_choice."""
    refuse: tuple[str, ...] = ()
    """'disturbed': stretches in which something acted on the arm are fitted and judged like all others; 'lean': the base
    stands as the model has it.
    """
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
    groups, motors = (list(training), list(held_out)), drives is not None and drives.motor_positions
    tree, (training, held_out), told_by_names = matched(tree, groups, wanted.torque, at_motors=motors)
    gears, rng = drives.only(tree.joints) if drives else Drives.direct(tree.joints), np.random.default_rng(wanted.seed)
    logs, judged = ([log_of(r, tree, gears) for r in group] for group in (training, held_out))
    warnings = [*told_by_names, *_minded(logs, judged, tree)]
    logs, judged, alone = without_disturbed(logs, judged, tree, gears, refused=NAME in wanted.refuse)
    cutoff = wanted.cutoff or natural_cutoff(logs)
    measured = measured_speed(logs, tree, gears, cutoff, wanted.hold_out)
    say("computing regressors")
    motions, others = ([log.motion(cutoff, measured_speed=measured) for log in group] for group in (logs, judged))
    prepared = _preparing(logs, motions, others, cutoff, wanted)
    scaled = _preparing(logs, motions, others, cutoff, replace(wanted, gains=True))
    model = cache(lambda tree, drives: prepared(tree, drives).model())
    coupling = coupled(motions, tree, gears, cutoff, wanted.hold_out)
    say("comparing clocks")
    warnings += [*alone, *doubts(logs, tree, coupling, prepared(tree, coupling).pool, prepared(tree, coupling).aligned)]
    warnings += beside_file(logs, tree)
    say("choosing the structure of friction")
    coupling = confirmed(coupling, gears, cache(lambda drives: left_out(model(tree, drives))))
    warnings += coupling_notes(coupling, gears)
    based, leans = as_it_leans(tree, lambda on: model(on, coupling), 1.0 / cutoff, wanted.refuse)
    warnings += [*leans, *own_scales(model(based, coupling), lambda: scaled(based, coupling).model(), 1.0 / cutoff)]
    warnings += changed_friction(model(based, coupling), 1.0 / cutoff)
    pool, nominal, alignment, (pieces, carried, moments, choice) = model(based, coupling)
    say("estimating")
    estimate, bodies, written, choice = _estimated(pool, pieces, nominal, choice, wanted)
    estimate = _doubted(estimate, fitted_rows(pieces), alignment, coupling.doubts)
    say("writing")
    return outcome(
        based, pool, choice, estimate, bodies and bodies.fit, written, pieces, alignment, carried=carried, moments=moments,
        nominal=nominal, units=logs[0].units, pull=bodies.pull if bodies else 0.0, cutoff=cutoff, warnings=warnings, rng=rng,
        started=started,
    )  # fmt: skip


def _doubted(estimate: Estimate, rows: Sequence[Rows], alignment: Alignment | None, doubts: Array | None) -> Estimate:
    """The estimate with deviations that count how far clocks and torque constants are known."""
    estimate = with_doubtful_clock(estimate, rows, alignment)
    return estimate if doubts is None else with_doubtful_torque(estimate, rows, doubts)


def _preparing(
    logs: Sequence[Log], motions: Sequence[Motion], judged: Sequence[Motion], cutoff: float, wanted: Options
) -> Callable[[KinematicTree, Drives], Prepared]:
    """What prepares motions for a tree and drives, once for each."""
    # What scales measured torque compensates something else: a pull towards the file, or friction of another form.
    scaled = wanted.gains or not all(log.measured for log in logs)
    return cache(partial(
        prepare, motions=motions, judged=judged, rate=logs[0].rate, cutoff=cutoff, scaled=scaled, align=wanted.align,
        hold_out=wanted.hold_out, structure=wanted.structure,
    ))  # fmt: skip


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


def _estimated(
    pool: Pool, pieces: Sequence[Piece], nominal: Array, choice: Choice, wanted: Options
) -> tuple[Estimate, Bodies | None, FileFit | None, Choice]:
    """The estimate, drawn to possible bodies as far as that predicts no worse, those bodies, what a model file can hold, and
    how strongly the estimate is drawn.
    """
    active, parts, prior = np.flatnonzero(choice.active), fitted_rows(pieces), pool.prior(nominal)
    robust = "huber" if wanted.robust else None
    free = least_squares(parts, active, choice.weights, prior=prior, strength=choice.strength, robust=robust)
    if robust is not None:
        free = with_missed_form(free, parts, prior, choice.strength)
    if not wanted.consistent:
        return free, None, None, choice
    # All samples, where the choice of the structure left out those at the borders of blocks; bodies by how each is trusted.
    every, trusted = moments_of(fitted_blocks(pieces, 0.0)), as_trusted(pieces, free.trust)
    moments = moments_of(fitted_blocks(trusted, 0.0))
    lag = wanted.structure == "select"
    among = np.union1d(active, pool.tied)
    bodies = cross_validated_fit(pool.model, moments, choice.weights, among, nominal, lag=lag)
    written = file_fit(pool, every, nominal, bodies.pull, [p.motion.v for p in pieces if not p.held_out], choice.active)
    if len(bodies.folds) < 2:
        return free, bodies, written, choice

    def judged(k: int) -> tuple[Moments, Array]:
        of = moments_of(kinds_of(pool, trusted)) if k else moments
        return of, of.scale * [pool.prior(fold.parameters) for fold in (bodies.without(of) if k else bodies.folds)]

    choice = select_pull(judged, choice)
    near = least_squares(
        parts,
        active,
        choice.weights,
        prior=pool.prior(bodies.fit.parameters),
        strength=choice.strength,
        trust=free.trust,
    )
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
    check_refused(options.refuse, (NAME, LEAN))
    if options.cutoff is not None and not options.cutoff > 0.0:
        raise IdentificationError(f"a cut-off of {options.cutoff:g} Hz is not above zero")
