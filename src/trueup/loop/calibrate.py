# SPDX-License-Identifier: Apache-2.0
"""Makes a simulator replay recordings of the robot: fit, choose what the data support, say how sure it is."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Calibration, CrossValidation, Replay
from trueup.controllers.controller import ControllerFactory
from trueup.discrepancies.discrepancy import Discrepancy
from trueup.discrepancies.weighted import Weighted
from trueup.ends import End
from trueup.engines.simulator import Simulator
from trueup.errors import CalibrationError
from trueup.inspection.outstanding import NAME
from trueup.inspection.released import LONG
from trueup.loop.changed import changes, of_several
from trueup.loop.checks import check, doubtful_units
from trueup.loop.chooser import Chooser
from trueup.loop.disturbed import LeftOut, deviations_in, disturbed
from trueup.loop.earlier import Earlier
from trueup.loop.estimates import as_unasked, estimated, judged_at_last, with_structure, with_ties
from trueup.loop.fit import Fit, Stage, fit, searched_by
from trueup.loop.held import held_open
from trueup.loop.horizon import cut_for_search
from trueup.loop.identifiability import unseen_directions, verdicts
from trueup.loop.limits import limits_seen, limits_untold
from trueup.loop.logged_torques import with_logged
from trueup.loop.missing import missing, unasked_by
from trueup.loop.problem import Problem
from trueup.loop.replay import replays
from trueup.loop.rivals import doubted, rivals, widened
from trueup.loop.selection import Choice
from trueup.loop.ties import considered, nuisance
from trueup.loop.uncertainty import as_wide_as_seen, unit_covariance
from trueup.loop.untold import as_open, open_covariance
from trueup.loop.validate import by_recording, left_out_errors
from trueup.loop.watch import Checkpoint, Progress, Watch
from trueup.parameters import ParameterSpace
from trueup.proportion import proportion_of
from trueup.recording import PART_OF, Recording
from trueup.search.least_squares import LeastSquares


@dataclass(frozen=True)
class Options:
    """How to calibrate; the defaults are meant to be right."""

    search: str = "auto"
    """'auto', 'gradient', 'cma-es' or 'hybrid'."""
    undisturbed: bool | None = None
    """Leave out stretches in which something acted on the robot that no model has; False: name them; None: do not ask."""
    select: bool = True
    """Freeze what the recordings cannot tell, and leave out optional structures that do not help."""
    robust: float = 3.0
    """Residuals beyond this many robust standard deviations count less; inf for plain least squares."""
    channels: tuple[str, ...] | None = None
    """Which measured channels to fit. None: positions and sensors that the simulator reproduces, or whatever there is;
    velocities repeat positions, and torques are often currents of unknown scale, so both wait to be asked for."""
    seed: int = 0
    cross_validate: bool = True
    later: tuple[str, ...] = ()
    """Optional structures (`Parameter.optional`) that are tried from the fit without them, beside those that say what it is
    like to be `Parameter.absent`."""
    windows: float | None = None
    """Recordings are replayed in windows of so many s, each from where the robot was measured to be then; inf: whole. None:
    as short as an unstable robot needs, or one that walks (`loop.windows`), whole with a discrepancy or controllers."""
    stages: tuple[Stage, ...] | None = None
    """What the search does, one thing after the other (`trueup.loop.fit.STAGES`), in place of `search`."""
    ends: tuple[End, ...] = ()
    """Conditions that stop a simulated run early: its last state is then compared with what the robot went on to do."""
    lacking: bool | None = None
    """Ask recordings what the simulator lacks, which can double the time, and take several times as long where feet touch.
    None: those of no more than a minute."""
    solver: Callable[..., LeastSquares] = LeastSquares
    """Makes the least squares that every look at the recordings is solved by."""


def calibrate(
    simulator: Simulator, recordings: Sequence[Recording], hold_out: Sequence[Recording] = (), *,
    options: Options | None = None, discrepancy: Discrepancy | None = None, controllers: ControllerFactory | None = None,
    progress: Progress | None = None, checkpoint: Checkpoint | None = None, resume: dict[str, Any] | None = None,
    space: ParameterSpace | None = None, start: Array | None = None, earlier: Earlier | None = None,
    left_out: LeftOut | None = None,
) -> Calibration:  # fmt: skip
    """Fits the simulator's free parameters to `recordings`, and judges the result on `hold_out` too.

    `space` may freeze more of them, `start` (n,) are values to search from (None: the nominal ones);
    `earlier` knew some of the recordings, and what its model lacks is not asked as if it had not. Where something acted on
    the robot that no model has, it begins anew without that (`Options.undisturbed`), as without what is `left_out` already.

    Raises CalibrationError where nothing can be fitted and SimulationFailedError where the start values already fail.
    """
    began, cpu, warnings = time.perf_counter(), time.process_time(), check(recordings, hold_out)
    known = LeftOut.kept_in(resume) if left_out is None else left_out
    less = replace(known, gaps=()) if options is not None and options.undisturbed is False else known
    training, judged = less.of(recordings), less.of(hold_out)
    space = simulator.parameters if space is None else space
    chosen = _with_entering(_whole(options or Options()) if discrepancy or controllers else options or Options(), space)
    left, chosen_before = _searched(space, chosen.later, resume)
    watch, chooser = Watch(progress, less.kept_by(checkpoint)), Chooser()
    laid = _Replayed.laid_out(simulator, training, chosen, space, start, discrepancy, controllers, watch)
    select = chooser if chosen.select and not chosen_before else None
    found = fit(problem := laid.problem, left, laid.begin, watch, resume=resume, select=select, **_how(chosen))
    if chosen.select and not found.disturbed.gaps:
        found = chooser.ended(problem, found, watch, {**_how(chosen), "later": ()})
    shown = () if found.disturbed.gaps else laid.replayed(found.values, judged)
    asked = bool(shown) and chosen.undisturbed is not None
    more = laid.disturbed(shown, found.values, judged) if asked else found.disturbed
    if chosen.undisturbed and more.touches(training):
        again = calibrate(
            simulator, recordings, hold_out, options=options, discrepancy=discrepancy, controllers=controllers,
            progress=progress, checkpoint=checkpoint, space=space, start=found.values, earlier=earlier,
            left_out=less.and_also(more),
        )  # fmt: skip
        return replace(again, evaluations=problem.evaluations + again.evaluations, seconds=time.perf_counter() - began,
                       cpu_seconds=time.process_time() - cpu)  # fmt: skip
    if chosen.undisturbed and more.gaps:
        shown = laid.replayed(found.values, judged := more.of(judged))
    left = known.and_also(more).sentences(bool(chosen.undisturbed))
    told = (*warnings, *doubtful_units((*training, *judged), shown), *left, *(several := changes(problem, found)))
    findings = _findings(problem, found, chooser.choices, laid.cut, earlier, chosen, watch, several)
    crossed = _cross_validation(problem, found, shown, chosen)
    return Calibration(replays=shown, cross_validation=crossed, trace=tuple(watch.trace), warnings=told, **findings,
                       evaluations=problem.evaluations, seconds=time.perf_counter() - began,
                       cpu_seconds=time.process_time() - cpu)  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Replayed:
    """How recordings are replayed, for the search and to be shown."""

    problem: Problem
    measure: Discrepancy
    channels: tuple[str, ...]
    begin: Array
    """(n,) values to search from."""
    lasting: float
    """s that windows may be long when they are shown."""
    cut: Sequence[str]
    """What is said of windows."""
    controllers: ControllerFactory | None

    @classmethod
    def laid_out(
        cls, simulator: Simulator, recordings: Sequence[Recording], chosen: Options, space: ParameterSpace,
        start: Array | None, discrepancy: Discrepancy | None, controllers: ControllerFactory | None, watch: Watch,
    ) -> _Replayed:  # fmt: skip
        """Whole, in windows in which slopes lead (see `cut_for_search`), or in such as are asked for; `watch` is told where
        a problem is simulated in between.
        """
        channels = sorted({c for r in recordings for c in simulator.observable(r)})
        measure, fitted = discrepancy or Weighted.estimated(recordings, channels), chosen.channels or usual(channels)
        problem = Problem(simulator, recordings, measure, fitted, controllers=controllers, ends=chosen.ends)
        problem.heard_by.append(watch.goes_on)
        waiting = [p.name for p in space.parameters if p.optional in chosen.later and not p.frozen]
        begin = space.without(waiting).nominal if start is None else start
        smooth = space.without(waiting) if chosen.windows is None else None
        problem, led, lasting, cut = cut_for_search(
            problem, begin, smooth, chosen.windows or np.inf, chosen.seed, watch
        )
        return cls(problem, measure, fitted, led if start is None else start, lasting, cut, controllers)

    def replayed(self, values: Array, hold_out: Sequence[Recording], longest: float = np.inf) -> tuple[Replay, ...]:
        """All that is fitted, and what is held out, with values (n,) and as the simulator came; begun anew after `longest` s
        at most.
        """
        return replays(self.problem.simulator, values, self.problem.recordings, hold_out, self.measure,
                       channels=self.channels, controllers=self.controllers, windows=min(self.lasting, longest))  # fmt: skip

    def disturbed(self, shown: Sequence[Replay], values: Array, hold_out: Sequence[Recording]) -> LeftOut:
        """What stands out of replays that are `shown`, and of such as begin anew every so often."""
        every = (*self.problem.recordings, *hold_out)
        return disturbed(
            deviations_in(shown, every), lambda: deviations_in(self.replayed(values, hold_out, LONG), every)
        )


def _whole(options: Options) -> Options:
    """Not in windows, unless options ask for some."""
    return options if options.windows is not None else replace(options, windows=np.inf)


def _with_entering(options: Options, space: ParameterSpace) -> Options:
    """With the structures that say what it is like to be without them among those that are tried later."""
    entering = [p.optional for p in space.parameters if p.optional and p.absent is not None]
    return replace(options, later=tuple(dict.fromkeys((*options.later, *entering))))


def _searched(
    space: ParameterSpace, later: Sequence[str], resume: dict[str, Any] | None
) -> tuple[ParameterSpace, bool]:
    """What is searched, and whether an interrupted search had already chosen from it. Raises CalibrationError."""
    if not space.free.any():
        raise CalibrationError("all parameters are frozen: nothing to calibrate")
    frozen, waiting = ({}, later) if resume is None else (resume.get("frozen", {}), resume.get("waiting", later))
    gone = [n for n in frozen if space[n].optional not in waiting]
    asked = [n for n in gone if space[n].optional in later]
    left = space.freeze(gone, frozen).without(asked)
    past = set(later).difference(waiting)  # what was kept of these is no longer asked about
    left = ParameterSpace(tuple(p.replace(optional="") if p.optional in past else p for p in left.parameters))
    return left, len(gone) - len(asked) > int((~space.free).sum())


def _how(options: Options) -> dict[str, Any]:
    without = {NAME} if not options.undisturbed else set()
    stages = tuple(s for s in options.stages or searched_by(options.search) if s.name not in without)
    return {"stages": stages, "robust": options.robust, "seed": options.seed, "solver": options.solver,
            "later": options.later}  # fmt: skip


def usual(channels: Sequence[str]) -> tuple[str, ...]:
    """The channels that are compared unless told otherwise (see `Options.channels`)."""
    return tuple(c for c in channels if c not in ("velocity", "torque")) or tuple(channels)


def _findings(
    problem: Problem, found: Fit, choices: Sequence[Choice], cut: Sequence[str], earlier: Earlier | None, chosen: Options,
    watch: Watch, several: Sequence[str],
) -> dict[str, Any]:  # fmt: skip
    """The fields of a Calibration that follow from the fit alone; `cut`: what is said of windows, `several`: of `changes`."""
    watch.saw("what the model lacks", problem, found.loss, problem.rmse(found.residual))
    covariance = unit_covariance(problem, found := as_wide_as_seen(problem, found))
    unasked = unasked_by(problem, found) if chosen.lacking is None else ()
    lacking = None if unasked or chosen.lacking is False else missing(problem, found, earlier)
    notes = (*found.notes, *(n for c in choices[1:] for n in c.notes), *unasked)
    declared = problem.simulator.parameters
    untold = [declared[n] for n in (choices[0].freeze if choices else ()) if found.space[n].frozen]
    limits = {**limits_seen(problem, found), **limits_untold(problem, found, untold)}
    open_, shared = open_covariance(problem, found, untold)
    estimates = estimated(found, open_, choices, declared, limits, notes)
    known, opened = (verdicts(found, c) for c in (covariance, open_))
    estimates = as_open(estimates, known, opened, shared, [p.name for p in untold])
    others = (*rivals(problem, found), *held_open(problem, found, untold, open_))
    wide = widened(with_structure(estimates, lacking), others)
    watch.saw("left-out recordings", problem, found.loss, problem.rmse(found.residual))
    owed = considered(found.shot or problem, found, covariance, {p.name for p in untold} - limits.keys())
    told = judged_at_last(doubted(with_ties(wide, owed, limits, declared), others), declared)
    measured = any("torque" in t.observed for t in problem.trials)
    grown = None if measured else proportion_of(problem.simulator, found.space)
    told, masses = (told, ()) if grown is None else grown.applied(told)
    if not measured:
        told = with_logged(told, problem.simulator, found.values, problem.recordings)
    return {
        "model_name": problem.simulator.name,
        "estimates": of_several(as_unasked(told, unasked), several),
        "covariance": _in_units(found, covariance),
        "nuisance": nuisance(owed),
        "unidentified": (*unseen_directions(found, covariance, limits), *(n for c in choices[:1] for n in c.words())),
        "notes": (*cut, found.ended, *notes, *masses),
        "lacking": lacking.words() if lacking else "",
        "lacked": lacking.lacked(p.name for p in found.space.parameters if not p.frozen) if lacking else None,
    }  # fmt: skip


def _in_units(found: Fit, covariance: Array) -> Array:
    slope = found.space.unit_slope(found.values)
    return covariance * np.outer(slope, slope)


def _cross_validation(
    problem: Problem, found: Fit, shown: Sequence[Replay], chosen: Options
) -> tuple[CrossValidation, ...]:
    """Replay errors of what is left out together, as shipped and by a fit that never saw it; none of a single recording."""
    if not chosen.cross_validate or len(problem.recordings) < 2:
        return ()
    blocks = by_recording(problem)
    main, unit = problem.main
    rows = []
    for block, after in zip(blocks, left_out_errors(problem, found, blocks), strict=True):
        own = [problem.recordings[problem.owners[k]] for k in block.trials]
        names = {r.name for r in own}
        seen = [r for r in shown if r.recording in names and r.channel == main and not r.held_out]
        before = [np.ravel(r.before - r.measured) for r in seen]
        if np.isnan(after) or not before:
            continue
        whole = own[0].provenance.get(PART_OF, own[0].name) if len(own) > 1 else own[0].name
        rows.append(CrossValidation(whole, float(np.sqrt(np.nanmean(np.concatenate(before) ** 2))), float(after), unit))
    return tuple(rows)
