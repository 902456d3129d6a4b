# SPDX-License-Identifier: Apache-2.0
"""The durable loop: rounds of experiment, calibrate, optimize, transfer, validate.

The code below is run from its beginning each time. What the journal holds is taken from there instead of being done
again, so that a campaign that was killed anywhere goes on as if it had not been: state is a replay.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from trueup.arrays import Array
from trueup.campaign.beginning import begun, require_unedited, sampled
from trueup.campaign.doses import Doses, doses_of
from trueup.campaign.events import (
    Begun,
    Calibrated,
    Chosen,
    Ended,
    Generation,
    RoundBegun,
    RoundEnded,
    Scored,
    TrialPlanned,
    Validated,
)
from trueup.campaign.hardware import Hardware
from trueup.campaign.history import unlike
from trueup.campaign.journal import Journal
from trueup.campaign.outcomes import belief_of, calibrated, chosen, generation, pairs, tried_in, validated
from trueup.campaign.parts import Listener, Parts, Silent
from trueup.campaign.plan import Plan
from trueup.campaign.rehearsal import rehearse
from trueup.campaign.retract import retractable
from trueup.errors import JournalError
from trueup.loop.belief import Belief
from trueup.loop.correction import Correction
from trueup.loop.experiment import most_telling, spread_settings
from trueup.loop.optimize import Optimum, TrustRegion, optimize
from trueup.loop.plausible import plausible
from trueup.loop.transfer import best_known, mean_score
from trueup.parameters import ParameterSpace
from trueup.rounding import NEGLIGIBLE
from trueup.tasks.task import counted_by, unit_of

E = TypeVar("E")

_EXPERIMENT, _MODELS, _SEARCH = range(3)  # what a round's generators are for


class Campaign:
    """One campaign, begun or taken up again from its journal."""

    def __init__(
        self, plan: Plan, checksum: str, version: str, parts: Parts, journal: Journal, listener: Listener | None = None
    ) -> None:
        """Raises JournalError where the journal is of another plan."""
        self._plan, self._parts, self._journal = plan, parts, journal
        self._listener = listener or Silent()
        self._hardware = Hardware(parts, journal, journal.folder, self._listener, self._once)
        self._scores: list[Scored] = []
        self._belief: Belief | None = None
        self._calibrated: Calibrated | None = None
        self._expected: list[tuple[float, float]] = []
        self._doses = doses_of(plan, parts)
        self._begun = begun(checksum, plan.seed, version, parts, self._doses)
        if journal.past and not (isinstance(journal.past[0], Begun) and journal.past[0].plan == checksum):
            raise JournalError(
                f"{journal.folder}: this folder holds a campaign of another plan; name another with --out"
            )

    def run(self) -> Ended:
        """Goes on to the end. Raises what robot, simulator and search raise; calling it again goes on from there."""
        past = self._journal.past
        if not any(isinstance(e, (TrialPlanned, Ended)) for e in past):
            self._listener.doubt(rehearse(self._parts, self._plan))  # first: a plan that fails leaves its folder free
        first = self._once(Begun, lambda: sampled(self._begun, self._parts))
        if past and isinstance(past[-1], Ended):
            return past[-1]
        if past and (edited := require_unedited(first, self._begun, self._parts, self._journal.folder)):
            self._listener.doubt(edited)
        start = np.clip(self._space.to_unit(self._space.nominal), 0.0, 1.0)
        region = TrustRegion(start, self._plan.optimize.trust)
        score, stale = float("nan"), 0
        ended: Ended | None = None
        for number in range(1, self._plan.stop.rounds + 1):
            begun = self._once(RoundBegun, lambda n=number, r=region: RoundBegun(n, tuple(r.centre.tolist()), r.radius))
            region = TrustRegion(np.array(begun.incumbent), begun.radius)
            last = self._round(number, region, score)
            stale = 0 if last.improved else stale + 1
            region, score = TrustRegion(np.array(last.best), last.radius), last.score
            ended = self._over(number, last, stale)
            if ended is not None or number == self._plan.stop.rounds:
                self._confirm(number)
                if ended is None or not ended.success or self._succeeds():
                    break
                best, score = self._best()  # it was one lucky run: go on from what is the best now
                region, ended = TrustRegion(best, region.radius), None
        final = ended or Ended("all rounds of the plan are done", success=False)
        return self._once(Ended, lambda: final)

    @property
    def _space(self) -> ParameterSpace:
        return self._parts.task.parameters

    @property
    def _counts(self) -> str:
        return counted_by(self._parts.task)

    def _round(self, number: int, region: TrustRegion, score: float) -> RoundEnded:
        belief = self._prior()
        self._experiment(number, region, belief)
        belief = self._calibrate(number)
        known = self._best()[1] if self._scored() else score
        if self._doses is not None:
            self._dosed(number, self._doses)
            return self._once(RoundEnded, lambda: self._round_ended(number, region, known))
        models = self._models(number, belief)
        correction = self._correction(models)
        optimum = self._optimize(number, models, region, correction)
        picked = self._once(
            Chosen,
            lambda: chosen(number, self._plan.transfer, self._parts, optimum, region, models, self._room(), correction),
        )
        far = unlike(picked.predicted[picked.incumbent], known, self._counts) if picked.incumbent >= 0 else ""
        if far and not self._journal.replaying:
            self._listener.doubt(far)
        fresh = len(self._hardware.recordings())
        plan = self._plan.transfer
        tested = self._hardware.test(number, "transfer", np.array(picked.candidates), plan.repeats, plan.again)
        self._scores += tested
        new = self._hardware.recordings()[fresh:]
        self._once(
            Validated, lambda: validated(number, self._parts, belief.values, picked, tested, new, self._expected)
        )
        self._expected += pairs(picked, tested, incumbent=not self._expected)
        return self._once(RoundEnded, lambda: self._round_ended(number, region, known))

    def _dosed(self, number: int, doses: Doses) -> None:
        """A round's trials one by one, each chosen by all runs before it."""
        plan = self._plan.transfer
        for k in range(plan.candidates):
            if self._room() < 1:  # runs that were aborted count
                return
            picked = self._once(Chosen, lambda: doses.chosen(number, self._scores, self._hardware.runs))
            unit = np.array(picked.candidates)
            self._scores += self._hardware.test(number, "transfer", unit, plan.repeats, plan.again, first=k)

    def _models(self, number: int, belief: Belief) -> Array:
        """(p, n) what the simulator's parameters may be, less what the robot's scores so far rule out."""
        spare = 4  # samples drawn for each that is kept
        plan, rng = self._plan.optimize, self._generator(number, _MODELS)
        units = [s.unit for s in self._scores]
        measured = np.array([mean_score(np.array(s.scores)) for s in self._scores])
        known = measured[np.isfinite(measured)]
        if plan.within == 0.0 or plan.samples == 1 or not len(known) or not (known > 0.0).all():
            return belief.sample(plan.samples, rng, widen=plan.widen)
        many = belief.sample(spare * plan.samples, rng, widen=plan.widen)
        tried = self._space.from_unit(np.array(units))
        return plausible(
            self._parts.task, self._parts.simulator, many, tried, measured, plan.samples, within=plan.within
        )

    def _correction(self, models: Array) -> Correction | None:
        """How far the robot's scores so far are from those of these models, where the plan asks for it."""
        if not self._plan.optimize.correct or not self._scored():
            return None
        units, scores = np.array([s.unit for s in self._scores]), [np.array(s.scores) for s in self._scores]
        fell = [s.fell for s in self._scores]
        return Correction.of(self._parts.task, self._parts.simulator, models, units, scores, fell)

    def _confirm(self, number: int) -> None:
        """Runs the best once more if it was run but once, and so on with what is the best then; three times at most."""
        plan = self._plan.transfer
        for _ in range(3 if plan.confirm else 0):
            if not self._scored() or self._room() < 1:
                return
            best, _score = self._best()
            tries = [s for s in self._scores if np.allclose(s.unit, best, atol=NEGLIGIBLE)]
            if sum(s.fell + int(np.isfinite(s.scores).sum()) for s in tries) > 1:
                return
            self._scores += self._hardware.test(number, "confirm", best[None], plan.repeats, plan.again)

    def _experiment(self, number: int, region: TrustRegion, belief: Belief) -> None:
        choices = 24  # settings among which an experiment is chosen
        plan = self._plan.experiment
        count = min(plan.settings if number == 1 else plan.later, self._room(plan.repeats))
        if count == 0:
            return
        rng = self._generator(number, _EXPERIMENT)
        units = region.centre[None] if number == 1 else np.zeros((0, len(region.centre)))
        more = count - len(units)
        if more > 0 and len(belief.unsure):
            options = spread_settings(region, choices, rng)
            known = () if number > 1 else (0,)
            choice = most_telling(self._parts.task, self._parts.simulator, belief, self._space.from_unit(options), more,
                                  noise=plan.noise, known=known)  # fmt: skip
            units = np.concatenate([units, options[list(choice.rows)]])
        self._scores += self._hardware.test(number, "experiment", units, plan.repeats, plan.again)

    def _prior(self) -> Belief:
        """What was believed before this round's experiment: the last calibration, or the ranges."""
        return self._belief or Belief.prior(self._parts.simulator.parameters)

    def _calibrate(self, number: int) -> Belief:
        if self._parts.calibrator is None:
            return Belief.prior(self._parts.simulator.parameters)
        fitted = (*self._parts.recordings, *self._hardware.recordings())
        if not fitted:
            return self._prior()
        if self._parts.later is not None:
            self._parts = self._parts.later(fitted)
        last = self._calibrated
        with retractable(self._journal.folder, fitted):
            event = self._once(Calibrated, lambda: calibrated(number, self._parts, fitted, self._listener, last))
        self._calibrated = event
        self._belief = belief_of(event, self._parts.simulator.parameters)
        return self._belief

    def _optimize(self, number: int, models: Array, region: TrustRegion, correction: Correction | None) -> Optimum:
        seed = int(np.random.SeedSequence([self._plan.seed, number, _SEARCH]).generate_state(1)[0])
        search = self._parts.search(region.inside(region.centre), seed)
        past = []
        while isinstance(self._journal.coming(), Generation):
            past.append(tried_in(self._once(Generation, _never)))
        try:
            return optimize(
                self._parts.task, self._parts.simulator, models, search, region, risk=self._plan.optimize.risk,
                evaluations=self._plan.optimize.evaluations, past=past,
                watch=lambda t: tried_in(self._once(Generation, lambda: generation(number, t))), correction=correction,
                evaluator=self._parts.evaluator,
            )  # fmt: skip
        finally:
            self._parts.evaluator.close()  # trials on the robot take long: nobody waits for them

    def _round_ended(self, number: int, region: TrustRegion, before: float) -> RoundEnded:
        if not self._scored():
            return RoundEnded(number, tuple(region.centre.tolist()), float("nan"), False, region.radius)
        best, score = self._best()
        improved = not score > before - self._plan.stop.improvement * abs(before)
        moved = region.moved(best, success=improved)
        early = self._doses.early(self._scores, best) if self._doses else ()
        return RoundEnded(number, tuple(moved.centre.tolist()), score, improved, moved.radius, early)

    def _over(self, number: int, last: RoundEnded, stale: int) -> Ended | None:
        stop = self._plan.stop
        if self._scored() and self._succeeds():
            unit, done = unit_of(self._parts.task), " (done)" if self._success_share() > 0.5 else ""
            score = f"{-last.score if self._counts else last.score:.4g} {unit}".rstrip()
            return Ended(f"success: {score}{done} on the robot in round {number}", success=True)
        if stale >= stop.patience:
            return Ended(f"no improvement on the robot in {stale} rounds in a row", success=False)
        if self._room() < 1 + self._plan.transfer.incumbent:
            return Ended(f"the budget of {stop.trials} runs on the robot is used up", success=False)
        return None

    def _room(self, repeats: int | None = None) -> int:
        """Candidates that the budget of runs still allows, with so many repeats (those of a transfer if None)."""
        if not self._plan.stop.trials:
            return 10**9
        each = len(self._parts.task.trials) * (repeats or self._plan.transfer.repeats)
        return max(0, (self._plan.stop.trials - self._hardware.runs) // each)

    def _scored(self) -> bool:
        return any(np.isfinite(s.scores).any() for s in self._scores)

    def _best(self) -> tuple[Array, float]:
        if self._doses is not None:
            return self._doses.best(self._scores)
        units, scores = [np.array(s.unit) for s in self._scores], [np.array(s.scores) for s in self._scores]
        return best_known(units, scores, [s.fell for s in self._scores])

    def _succeeds(self) -> bool:
        """Whether the best scores well enough for the plan, or does the task in most of its runs where that can be said."""
        return self._plan.stop.reached(self._best()[1], self._counts) or self._success_share() > 0.5

    def _success_share(self) -> float:
        """Share of the best's runs in which the task was done; NaN where there is no such thing."""
        best, _ = self._best()
        shares = [s.done for s in self._scores if np.allclose(s.unit, best, atol=NEGLIGIBLE)]
        return float(np.mean(shares))

    def _generator(self, number: int, purpose: int) -> np.random.Generator:
        return np.random.default_rng([self._plan.seed, number, purpose])

    def _once(self, kind: type[E], make: Callable[[], E]) -> E:
        fresh = not self._journal.replaying
        event = self._journal.once(kind, make)
        self._listener.saw(event, fresh=fresh)  # type: ignore[arg-type]
        return event


def _never() -> Generation:
    raise JournalError("a generation was to be taken from the journal, but it is not there")
