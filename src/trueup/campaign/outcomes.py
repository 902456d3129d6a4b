# SPDX-License-Identifier: Apache-2.0
"""What the loop's functions find, as events, and back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Calibration, Lacked, Nuisance, pooled_rmse
from trueup.campaign.events import Calibrated, Chosen, Generation, Row, Scored, Validated
from trueup.campaign.parts import Listener, Parts
from trueup.campaign.plan import Transfer
from trueup.errors import CalibrationError, JournalError, TrialError
from trueup.evidence import Evidence
from trueup.loop.belief import Belief
from trueup.loop.correction import Correction
from trueup.loop.earlier import Earlier
from trueup.loop.optimize import Optimum, Tried, TrustRegion
from trueup.loop.ranking import agreement
from trueup.loop.replay import replay_error
from trueup.loop.safety import exceeded, predicted
from trueup.loop.transfer import Shortlist, mean_score, prepared, shortlist
from trueup.parameters import ParameterSpace
from trueup.recording import Recording
from trueup.tasks.task import robot_trials


def calibrated(
    number: int, parts: Parts, fitted: Sequence[Recording], listener: Listener, last: Calibrated | None = None
) -> Calibrated:
    """Fits the simulator, from the last round's fit if there is one, writes it, hands it to the listener, and keeps what the
    loop needs of it.
    """
    if parts.calibrator is None:
        raise CalibrationError("the plan calibrates nothing")
    earlier = None if last is None else _earlier(last)
    found = parts.calibrator(fitted, parts.held_out, listener.fitting, earlier)
    if parts.write is not None:
        parts.write(number, found, fitted)
    listener.calibrated(number, found)
    e = found.estimates
    main = _main(found)
    shown = [r for r in found.training() if r.channel == main]
    return Calibrated(
        number, tuple(x.name for x in e), tuple(x.unit for x in e), _row([x.value for x in e]),
        tuple(x.fitted for x in e), _row([x.low for x in e]), _row([x.high for x in e]), tuple(x.verdict for x in e),
        tuple(_row(r) for r in np.atleast_2d(found.covariance)) if np.size(found.covariance) else (),
        pooled_rmse(shown, after=False), pooled_rmse(shown, after=True), shown[0].unit if shown else "",
        tuple(r.name for r in fitted),
        {} if found.lacked is None else {name: _row(r) for name, r in found.lacked.intervals.items()},
        () if found.lacked is None else (found.lacked.shown.gain, found.lacked.shown.standard_error),
        *_unasked(found.nuisance),
    )  # fmt: skip


def _unasked(nuisance: Nuisance | None) -> tuple[dict[str, Row], dict[str, Row]]:
    if nuisance is None:
        return {}, {}
    covariances, owed = (
        {name: _row(row) for name, row in zip(nuisance.names, rows, strict=True)}
        for rows in (nuisance.covariance, nuisance.trade.T)
    )
    return covariances, owed


def _nuisance(event: Calibrated) -> Nuisance | None:
    if not event.unasked:
        return None
    names = tuple(event.unasked)
    trade = np.array([event.owed[name] for name in names]).T
    return Nuisance(names, np.array([event.unasked[name] for name in names]), trade)


def _earlier(last: Calibrated) -> Earlier:
    intervals = {name: (value, low, high) for name, (value, low, high) in last.lacked.items()}
    lacked = Lacked(intervals, Evidence(*last.lacked_evidence)) if intervals else None
    return Earlier.estimated(last.names, last.values, last.verdicts, last.recordings, lacked)


def belief_of(event: Calibrated, space: ParameterSpace) -> Belief:
    """What a journaled calibration leaves to believe; parameters that its simulator had not yet are as declared.

    Raises JournalError for parameters that the simulator no longer has.
    """
    if gone := [name for name in event.names if name not in space.names]:
        raise JournalError(
            f"the campaign's last calibration found {', '.join(gone)}, which its simulator no longer has: another version of "
            "trueup wrote it. Its model files are read; begin a new campaign with the last of them"
        )
    values = {p.name: p.nominal for p in space.parameters} | dict(zip(event.names, event.values, strict=True))
    fitted = dict(zip(event.names, event.fitted, strict=True))
    verdicts = dict(zip(event.names, event.verdicts, strict=True))
    return Belief.estimated(
        space, np.array(list(values.values())), np.array([fitted.get(name, False) for name in values]),
        np.array(event.covariance, dtype=np.float64).reshape(sum(event.fitted), -1),
        tuple(verdicts.get(name, "frozen") for name in values), _nuisance(event),
    )  # fmt: skip


def generation(number: int, tried: Tried) -> Generation:
    """One generation of a search as an event."""
    rows = tuple(_row(r) for r in tried.candidates)
    return Generation(number, rows, _row(tried.losses), _row(tried.means), _row(tried.spreads))


def tried_in(event: Generation) -> Tried:
    """The generation that an event holds."""
    return Tried(np.array(event.candidates), np.array(event.losses), np.array(event.means), np.array(event.spreads))


def chosen(
    number: int, plan: Transfer, parts: Parts, optimum: Optimum, region: TrustRegion, models: Array, room: int,
    correction: Correction | None = None,
) -> Chosen:  # fmt: skip
    """What goes to the robot: distinct candidates whose simulated runs stay within the limits.

    Raises TrialError where none does.
    """
    wanted = max(0, min(plan.candidates, room - plan.incumbent))
    many = wanted if parts.limits is None else 4 * wanted
    found = shortlist(optimum, region, many, apart=plan.apart, incumbent=plan.incumbent, task=parts.task,
                      simulator=parts.simulator, models=models, correction=correction)  # fmt: skip
    beyond = [problems(parts, unit, models[0]) for unit in found.unit]
    safe = [k for k, p in enumerate(beyond) if not p][: wanted + (found.incumbent >= 0)]
    if not safe or (found.incumbent >= 0 and 0 not in safe):
        raise TrialError(
            "no candidate stays within the limits: " + "; ".join(dict.fromkeys(s for p in beyond for s in p))
        )
    kept = Shortlist(found.unit[safe], found.predicted[safe], found.spreads[safe], found.incumbent)
    return Chosen(
        number, tuple(_row(r) for r in kept.unit), _row(kept.predicted), _row(kept.spreads), kept.incumbent,
        sum(bool(p) for p in beyond), optimum.ended,
    )  # fmt: skip


def validated(
    number: int, parts: Parts, values: Array, picked: Chosen, tested: Sequence[Scored], new: Sequence[Recording],
    earlier: Sequence[tuple[float, float]],
) -> Validated:  # fmt: skip
    """How well the simulator foretold the runs that it had not seen; `earlier` are `pairs` of the rounds before."""
    rank = agreement(*zip(*pairs(picked, tested, incumbent=True), strict=True))
    every = agreement(*zip(*[*earlier, *pairs(picked, tested, incumbent=not earlier)], strict=True))
    replayed = replay_error(
        parts.simulator, values, parts.suited(new), discrepancy=parts.discrepancy, channels=parts.channels
    )
    measured = _row([mean_score(np.array(s.scores)) for s in tested])
    return Validated(
        number, picked.predicted, measured, rank.tau, rank.low, rank.high, rank.spearman, every.tau, every.low, every.high,
        replayed.shipped, replayed.calibrated, replayed.unit,
    )  # fmt: skip


def pairs(picked: Chosen, tested: Sequence[Scored], *, incumbent: bool) -> list[tuple[float, float]]:
    """(expected, measured) of each candidate, with or without the incumbent; a fall is worse than any score."""
    measured = np.array([mean_score(np.array(s.scores)) for s in tested])
    known = measured[np.isfinite(measured)]
    worst = float(known.max()) if len(known) else 0.0
    ranked = [worst + 1.0 if s.fell else float(m) for s, m in zip(tested, measured, strict=True)]
    return [
        pair for k, pair in enumerate(zip(picked.predicted, ranked, strict=True)) if incumbent or k != picked.incumbent
    ]


def problems(parts: Parts, unit: Array, model: Array) -> tuple[str, ...]:
    """What a candidate's commands and its simulated runs go beyond."""
    if parts.limits is None:
        return ()
    values = parts.task.parameters.from_unit(unit)
    trials = [prepared(t, parts.limits, 1) for t in robot_trials(parts.task, values)]
    rows = np.concatenate([model, values])[None]
    commanded = [sentence for t in trials for sentence in exceeded(t)]
    return (*commanded, *predicted(parts.simulator.rollout(trials, rows, parts.task.controllers)))


def _main(calibration: Calibration) -> str:
    names = [r.channel for r in calibration.replays]
    return "position" if "position" in names else names[0] if names else ""


def _row(values: object) -> Row:
    return tuple(float(v) for v in np.asarray(values, dtype=np.float64))
