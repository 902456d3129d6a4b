# SPDX-License-Identifier: Apache-2.0
"""What is said of each parameter: value, interval and a word, by where the fit ended and what it could not know."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import nan

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Estimate
from trueup.evidence import HALVED, half_interval
from trueup.loop.considered import STEP, Considered
from trueup.loop.fit import Fit
from trueup.loop.identifiability import verdicts
from trueup.loop.limits import Seen, is_limit
from trueup.loop.missing import Missing
from trueup.loop.rivals import SAME
from trueup.loop.selection import Choice
from trueup.loop.uncertainty import intervals
from trueup.parameters import Parameter, ParameterSpace
from trueup.samples import MOST
from trueup.verdicts import AT_BOUND, Verdict, roughly_known


def estimated(
    found: Fit,
    covariance: Array,
    choices: Sequence[Choice],
    declared: ParameterSpace,
    limits: Mapping[str, Seen],
    notes: Sequence[str],
) -> tuple[Estimate, ...]:
    """Of all parameters as `declared`, with a `covariance` (n_free, n_free) in the unit box."""
    low, high = intervals(found, covariance)
    words = iter(zip(low, high, verdicts(found, covariance), found.unit, strict=True))
    unseen, vague = (choices[0].freeze, choices[0].vague) if choices else ((), ())
    rows = []
    for p, start, value in zip(found.space.parameters, declared.nominal, found.values, strict=True):
        lo, hi, verdict, unit = (nan, nan, None, nan) if p.frozen else next(words)
        if verdict is not None and p.name not in unseen:
            word, note = verdict.word, verdict.note
            if word == AT_BOUND:  # which it holds: a search ends a hair beside that
                lo, hi = (p.lower, hi) if unit < HALVED else (lo, p.upper)
            if seen := limits.get(p.name):
                if seen.word == "identified" and word in ("identified", "weak"):  # slopes know what jumps leave unsure
                    lo, hi = min(lo, seen.low), max(hi, seen.high)
                else:
                    lo, hi = seen.low, seen.high
                word, note = seen.word, seen.note
            elif word == "not identified" and p.name in vague:
                word, note = (
                    "weak",
                    "left-out recordings replay better with it than at its start value, yet it is vague",
                )
        else:
            word, note = _frozen(declared[p.name], unseen, notes)
            if p.name in unseen and p.name in limits:
                note = f"{note}; {limits[p.name].note}"
        rows.append(
            Estimate(p.name, p.unit, float(start), float(value), float(lo), float(hi), p.lower, p.upper, not p.frozen, word,
                     note, absent=p.frozen and ((is_limit(p) and value == p.absent) or value == p.unidentified))
        )  # fmt: skip
    return tuple(rows)


def with_structure(estimates: Sequence[Estimate], lacking: Missing | None) -> tuple[Estimate, ...]:
    """With intervals that hold whether the robot has a structure or not, and a word for what replays best in its place."""
    if lacking is None:
        return tuple(estimates)
    free = iter(zip(lacking.values, lacking.low, lacking.high, strict=True))
    rows = []
    for e in estimates:
        if e.fitted:
            value, low, high = map(float, next(free))
            wide = replace(e, low=min(e.low, low), high=max(e.high, high))
            if e.verdict in ("identified", "weak") and abs(value - e.value) > SAME * abs(e.value):
                wide = replace(wide, verdict="effective", note=f"replays best, yet with {lacking.name} it would be "
                               f"{value:.4g} [{low:.4g}, {high:.4g}] {e.unit}".rstrip())  # fmt: skip
            elif e.verdict == "identified" and wide.high - wide.low > 2.0 * MOST * abs(e.value):
                wide = replace(wide, verdict="weak", note=f"known roughly only: the model lacks {lacking.name}")
            e = wide
        rows.append(e)
    return tuple(rows)


def as_unasked(estimates: Sequence[Estimate], unasked: Sequence[str]) -> tuple[Estimate, ...]:
    """With the word for values that may stand for what the model lacks, where errors beyond noise are left and it was not
    asked what that is, as `unasked` says (see `missing.unasked_by`).
    """
    note = "replays best; what the model lacks, for which it may stand, was not asked (--lacking)"
    return tuple(
        replace(e, verdict="effective", note=note) if unasked and e.verdict == "identified" else e for e in estimates
    )


def with_ties(
    estimates: Sequence[Estimate], others: Sequence[Considered], limits: Mapping[str, Seen], declared: ParameterSpace
) -> tuple[Estimate, ...]:
    """With intervals that hold whatever related quantities are that nobody asked for, and words where those rule. Limits
    are told by when they are met, and owe to the step alone.
    """
    places = {e.name: k for k, e in enumerate(e for e in estimates if e.fitted)}
    step = [o for o in others if o.parameter.name == STEP]
    return tuple(
        _with_others(e, step if e.name in limits else others, places[e.name], declared[e.name]) if e.fitted else e
        for e in estimates
    )


def _with_others(e: Estimate, others: Sequence[Considered], place: int, p: Parameter) -> Estimate:
    reaches = np.array([o.reach(float(o.trade[place])) for o in others]).reshape(-1, 2)
    steps = np.array([o.parameter.name == STEP for o in others], dtype=bool)
    down, up = np.sqrt(np.array([e.value - e.low, e.high - e.value]) ** 2 + np.sum(reaches[~steps] ** 2, axis=0))
    # The error of a step is no draw about zero: the whole of it comes on top of what is drawn.
    down, up = np.array([down, up]) + np.sum(reaches[steps], axis=0)
    width = e.high - e.low
    wide = replace(e, low=float(max(e.value - down, e.lower_bound)), high=float(min(e.value + up, e.upper_bound)))
    ruled = width < HALVED * (wide.high - wide.low) or (_rough(wide, p) is not None and _rough(e, p) is None)
    if e.verdict not in ("identified", "weak") or not ruled:
        return wide
    k = int(np.argmax(reaches.max(axis=1)))
    if reaches[k].max() < SAME * abs(e.value):
        return wide
    return replace(wide, verdict=others[k].verdict, note=others[k].words(e, float(others[k].trade[place])))


def judged_at_last(estimates: Sequence[Estimate], declared: ParameterSpace) -> tuple[Estimate, ...]:
    """With the words that final intervals deserve: what ties and structures have widened may be known roughly only."""
    rough = {e.name: _rough(e, declared[e.name]) for e in estimates if e.verdict == "identified"}
    return tuple(
        e if (verdict := rough.get(e.name)) is None else replace(e, verdict=verdict.word, note=verdict.note)
        for e in estimates
    )


def _rough(e: Estimate, p: Parameter) -> Verdict | None:
    """The word for an interval that is wide beside its value; None elsewhere."""
    ends = ParameterSpace((p.replace(frozen=False),)).to_unit(np.clip([[e.low], [e.high]], p.lower, p.upper))
    return roughly_known(p, float(np.ptp(ends)) / (2.0 * half_interval()), e.value, e.low, e.high)


def _frozen(p: Parameter, unseen: Sequence[str], notes: Sequence[str]) -> tuple[str, str]:
    if p.frozen:
        return "frozen", "as declared"
    if p.name in unseen:
        kept = "kept at its start value" if p.unidentified is None else "none is simulated"
        return "not identified", f"these recordings cannot tell it; {kept}"
    judged = next((n for n in notes if p.optional and n.startswith(f"{p.optional} left out: ")), "")
    if judged:
        return "not supported", judged.removeprefix(f"{p.optional} left out: ")
    if any(n.startswith(f"{p.optional} kept") for n in notes):
        return "not supported", "this signal is not replayed better with one of its own"
    return "not supported", "leaving it out does not raise the error on left-out recordings"
