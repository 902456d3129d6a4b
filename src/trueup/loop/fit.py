# SPDX-License-Identifier: Apache-2.0
"""Finds the values that replay the recordings best, in stages: short and coarse first, then everything at the full step."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from trueup.arrays import Array, Mask
from trueup.errors import CalibrationError
from trueup.evidence import EXCERPT
from trueup.inspection.outstanding import NAME
from trueup.loop.alike import all_alike
from trueup.loop.apart import GLANCE
from trueup.loop.delayed import delays
from trueup.loop.descent import Descent, Fit, Select
from trueup.loop.elsewhere import EVOLVING
from trueup.loop.growth import growth, growth_apart
from trueup.loop.interior import nudge
from trueup.loop.joint_by_joint import each_apart, glance
from trueup.loop.mixed import Mixed
from trueup.loop.problem import FAITHFUL, Problem
from trueup.loop.profiles import off_bounds, profiles
from trueup.loop.shooting import multiple_shooting
from trueup.loop.stages import (
    Run,
    Stage,
    as_it_came,
    coarse_step,
    evolution,
    evolve_first,
    evolve_long,
    first_seconds,
    full_step,
    implicit_filtering,
    lines,
    longer_parts,
    probing,
    refinement,
    selection,
)
from trueup.loop.undisturbed import undisturbed
from trueup.loop.untold import asked_again
from trueup.loop.watch import Checkpoint, Progress, Watch
from trueup.loop.weighing import weighing
from trueup.parameters import ParameterSpace
from trueup.search.least_squares import LeastSquares
from trueup.trial import STEP

__all__ = [
    "DESCENT",
    "REFINEMENT",
    "SEARCHES",
    "SHIPPED",
    "STAGES",
    "Checkpoint",
    "Fit",
    "Progress",
    "Stage",
    "Watch",
    "fit",
]


_SHORT = (GLANCE, EXCERPT)  # s: the first stage looks at the first quarter of the recordings, within these bounds
_COARSE = (2.5, 2.0, 1.5)  # factors on the integration step while far from the optimum; the first that is faithful

_LINES, _EVOLUTION, _SELECTION = Stage("lines", lines), Stage("evolution", evolution), Stage("selection", selection)
_AGAIN = Stage("asked again", asked_again)
_APART, _GLANCE = Stage("joint by joint", each_apart), Stage("glance", glance)
_GROWTH_APART = Stage("growth joint by joint", growth_apart)
_ALIKE, _DELAYS = Stage("all alike", all_alike), Stage("along delays", delays)
_FIRST = Stage("first seconds", first_seconds)
_COARSE_STEP = Stage("all, coarse step", coarse_step)
_LONGER = Stage("longer parts", longer_parts)
_ALONE = Stage(NAME, undisturbed)
_FULL, _GROWTH = Stage("all, full step", full_step), Stage("growth", growth)
_PROFILES = Stage("profiles", profiles)
_SHOOTING = Stage("multiple shooting", multiple_shooting)
_WEIGHING = Stage("weighing", weighing)
_PROBING = Stage("probe", probing)
_AROUND = (_SHOOTING, _WEIGHING, Stage("implicit filtering", implicit_filtering), _PROBING)

_ELSEWHERE = (_LINES, _EVOLUTION)

STAGES = (
    _APART, _GLANCE, _GROWTH_APART, _ALIKE, _DELAYS, _FIRST, *_ELSEWHERE, _COARSE_STEP, _LONGER, _ALONE, *_ELSEWHERE,
    _PROFILES, _SELECTION, _GROWTH, _FULL, _LONGER, *_ELSEWHERE, _PROFILES, _SELECTION, _GROWTH, _AGAIN,
    Stage("off bounds", off_bounds), *_AROUND,
)  # fmt: skip
"""What a search does unless told otherwise."""
_FIRST_LOOKS = (_APART, _GROWTH_APART, _ALIKE, _DELAYS, _FIRST, _COARSE_STEP)
_LAST_LOOKS = (_SELECTION, _GROWTH, _FULL, _SELECTION, _GROWTH, _AGAIN)
DESCENT = (*_FIRST_LOOKS, *_LAST_LOOKS)
"""Nothing but where slopes lead."""
REFINEMENT = (Stage("refinement", refinement), _SHOOTING, _WEIGHING, _PROBING)
"""From an earlier fit of most of the recordings."""
SHIPPED = (Stage("as it came", as_it_came),)
"""Nothing is searched."""
_SLOPES = (*_FIRST_LOOKS, _ALONE, *_LAST_LOOKS, *_AROUND)

SEARCHES = {
    "auto": STAGES,
    "gradient": _SLOPES,
    "cma-es": (Stage(EVOLVING, evolve_long), *_SLOPES),
    "hybrid": (Stage(EVOLVING, evolve_first), *_SLOPES),
}
"""Searches by the names that a user may give."""


def fit(
    problem: Problem, space: ParameterSpace, start: Array, watch: Watch, *, stages: Sequence[Stage] = STAGES,
    robust: float = 3.0, seed: int = 0, resume: dict[str, Any] | None = None, select: Select | None = None,
    solver: Callable[..., LeastSquares] = LeastSquares, later: Sequence[str] = (), begun: Fit | None = None,
) -> Fit:  # fmt: skip
    """Values of the free parameters that minimise the robust discrepancy, starting from values (n,).

    `stages` are gone through in their order (see `STAGES`, and `SEARCHES` for others), with `solver` for the least squares.
    `select` is asked which parameters to keep as soon as all recordings were looked at. Optional structures in `later` are
    absent until then (see `growth.py`). `begun`: an earlier fit of the same recordings, from which a cheaper problem and
    corrections of starts are taken over.
    """
    watch.waiting = tuple((resume or {}).get("waiting", later))
    watch.entered, watch.bare = (resume or {}).get("entered", {}), (resume or {}).get("bare", ())
    waiting = {s: {p.name: p for p in space.parameters if p.optional == s and not p.frozen} for s in watch.waiting}
    names = [name for declared in waiting.values() for name in declared]
    if len(names) < int(space.free.sum()):
        space = space.without(names)
    else:
        waiting = {}
    waiting = {structure: declared for structure, declared in waiting.items() if declared}
    point = np.clip(space.to_unit(start), 0.0, 1.0)
    coarse = coarsest(problem, space, point, begun)
    descent = Descent(space, point, watch, robust, solver=solver)
    run = Run(
        problem,
        coarse,
        np.asarray(start, dtype=np.float64),
        descent,
        select,
        seed,
        _first(coarse),
        later=waiting,
        starts=None if begun is None else begun.starts,
    )
    if begun is not None:
        kept = np.array([not space[p.name].frozen for p in begun.space.parameters if not p.frozen], dtype=bool)
        descent.take_up(begun.jacobian[:, kept])
        run.weighed = _going_on(begun, kept, descent)
    for stage in stages[_begin(run, stages, resume) :]:
        stage.act(run)
        if run.disturbed.gaps:
            break
    step = None if run.coarse is run.problem else run.coarse.simulator.step
    notes = (*run.notes, *_approximated(run.fit.near or run.coarse))
    return replace(run.fit, notes=notes, coarse_step=step, disturbed=run.disturbed)


def _going_on(begun: Fit, kept: Mask, descent: Descent) -> Fit | None:
    """An earlier fit by slopes over a stretch, of what of it is `kept` (n_free,); None where it is another, or of less."""
    if not begun.weighed or int(kept.sum()) != len(descent.point):
        return None
    scatter = None if begun.scatter is None else begun.scatter[np.ix_(kept, kept)]
    jacobian = begun.jacobian[:, kept]
    return replace(begun, space=descent.space, unit=descent.point, jacobian=jacobian, scatter=scatter, notes=())


def _approximated(problem: Problem) -> tuple[str, ...]:
    """A note where recordings were searched in an approximation of the simulator."""
    if not isinstance(problem.simulator, Mixed):
        return ()
    but = f" but {', '.join(sorted(problem.simulator.exact))}, where it is off" if problem.simulator.exact else ""
    return (f"searched with an approximation of the simulator in all recordings{but}; the simulator had the last word",)


def searched_by(name: str) -> tuple[Stage, ...]:
    """The stages of a search by its name. Raises CalibrationError for other words."""
    if name not in SEARCHES:
        raise CalibrationError(f"search '{name}' is not one of: {', '.join(SEARCHES)}")
    return SEARCHES[name]


def _begin(run: Run, stages: Sequence[Stage], resume: dict[str, Any] | None) -> int:
    """At which stage an interrupted search goes on."""
    if not resume:
        return 0
    names = [stage.name for stage in stages]
    if resume["stage"] == EVOLVING and EVOLVING not in names:
        return 0  # stopped while CMA-ES followed slopes: nothing in what was saved says where these had led
    run.saved, run.resumed = resume["search"], resume["stage"] != EVOLVING
    return names.index(resume["stage"]) if resume["stage"] in names else names.index("all, full step")


def _first(coarse: Problem) -> Problem:
    long = max(t.duration for t in coarse.trials)
    first = float(np.clip(long / 4.0, *_SHORT))
    return coarse.shortened(first) if long > 2.0 * first else coarse


def coarsest(problem: Problem, space: ParameterSpace, point: Array, begun: Fit | None = None) -> Problem:
    """The problem at the coarsest step that tells nearly the same residuals at the start, and where a search begins that may
    be nudged off its bounds, or at the usual one, approximated where that does; as an earlier fit has had it.
    """
    if begun is not None and begun.near is not None:
        return begun.near.with_starts(problem.trials, ())
    point = np.clip(point, 0.0, 1.0)
    moved = nudge(problem, space, point)
    places = space.from_unit(np.stack([point, np.clip(point, moved, 1.0 - moved)]))
    start, nudged = problem.residuals(places[:1])[0], problem.start_residual(places[1])
    fine = [start, nudged] if np.isfinite(start).all() else [nudged]
    own = problem.simulator.step
    # The usual step leads near enough for a shorter one to end: of an arm that steps by 0.25 ms in 42 CPU s for 114.
    longer = {STEP, *(factor * own for factor in _COARSE)}
    for step in sorted((s for s in longer if s > own), reverse=True):
        cheap = problem.at_step(step)
        rough = cheap.residuals(places[-len(fine) :])
        if np.isfinite(rough).all() and (step == STEP or _faithful(rough, fine)):
            return cheap.approximated(places[1], nudged)
    return problem.approximated(places[1], nudged)


def _faithful(rough: Iterable[Array], fine: Sequence[Array]) -> bool:
    """Whether a coarse step tells nearly the same residuals (m,) as a fine one at each place."""
    pairs = zip(rough, fine, strict=True)
    return all(np.linalg.norm(near - real) <= FAITHFUL * np.linalg.norm(real) for near, real in pairs)
