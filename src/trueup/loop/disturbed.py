# SPDX-License-Identifier: Apache-2.0
"""Stretches in which something acted on the robot that no model has: a collision, a hand, drives that let go.

Where a model replays recordings but for a few stretches, off there by far more than anywhere else although nothing out of the
ordinary was asked of the robot, it has its drives and links. What acted then is in no log, so no values replay it, and a
robust loss only keeps it from doing worse.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Replay
from trueup.evidence import half_interval
from trueup.inspection.outstanding import NAME, joined, outstanding
from trueup.inspection.pauses import parts_between
from trueup.inspection.released import LONG
from trueup.inspection.repeats import BASE
from trueup.inspection.stamps import Gap
from trueup.instant import CUBIC
from trueup.loop.problem import Problem
from trueup.noise import UNUSUAL
from trueup.recording import Recording
from trueup.samples import MOST
from trueup.trial import SETTLE, command_of

_LEAST = 1e-3
"""rad, m or N m that a command goes at least: encoders see less than that, and numbers are written with as much."""

_JOINTS = "position"
"""The channel in which it is seen."""


@dataclass(frozen=True, eq=False)
class Deviation:
    """How far the joints of a recording are from their replay."""

    recording: Recording
    labels: tuple[str, ...]
    time: Array
    """(T,) in s."""
    off: Array
    """(T, k) in units of the noise, without sign; NaN where nothing was measured."""
    unit: Array
    """(k,) one unit of it in rad or m."""

    @cached_property
    def demand(self) -> Array:
        """(T, c, 2) how far each command goes within `LONG` before an instant, and how much its speed changes there at most
        (over `CUBIC`): what a model lacks of gears that twist grows with that.
        """
        command = command_of(self.recording)
        if command is None:
            return np.zeros((len(self.time), 0, 2))
        now, before, long_before = (
            np.nan_to_num(command.at(self.time - s, hold=True)) for s in (0.0, CUBIC, 2.0 * CUBIC)
        )
        known = self.time - 2.0 * CUBIC >= self.time[0]  # before the log nobody knows
        turns = np.where(known[:, None], np.abs(now - 2.0 * before + long_before), 0.0)
        asked = np.zeros((*now.shape, 2))
        for b, a in enumerate(np.searchsorted(self.time, self.time - LONG)):
            asked[b, :, 0], asked[b, :, 1] = np.ptp(now[a : b + 1], axis=0), turns[a : b + 1].max(axis=0)
        return asked

    @property
    def commands(self) -> tuple[str, ...]:
        """The labels of its commands."""
        command = command_of(self.recording)
        return () if command is None else command.labels


@dataclass(frozen=True, eq=False)
class _Stretch:
    """Where joints are far off: of the samples of `deviation`, `first` to `last`."""

    deviation: Deviation
    first: int
    last: int
    times: Array
    """(k,) how far each joint is off at most, in times of what is usual."""
    excess: float
    """The largest of these, for each time that more was asked than elsewhere."""

    @property
    def gap(self) -> Gap:
        """With what hangs on it before and behind."""
        time = self.deviation.time
        start = max(float(time[0]), float(time[self.first]) - 0.5 * LONG)
        return Gap(start, float(time[self.last]) + 0.5 * LONG - start)

    def meets(self, other: _Stretch) -> bool:
        """Whether another is of the same recording and meets it in time."""
        own, its = self.gap, other.gap
        apart = own.start > its.start + its.duration or its.start > own.start + own.duration
        return self.deviation.recording is other.deviation.recording and not apart

    def words(self, rest: float) -> str:
        """When, and how far which joints are off, with `rest` of the others in times of what is usual."""
        far = [k for k in np.argsort(-self.times).tolist() if self.times[k] > UNUSUAL]
        most = np.nan_to_num(self.deviation.off[self.first : self.last + 1]).max(axis=0) * self.deviation.unit
        unit = {"rad": "mrad", "m": "mm"}
        units = [unit[self.deviation.recording.channel(_JOINTS).unit_of(label)] for label in self.deviation.labels]
        named = ", ".join(f"{self.deviation.labels[k]} by {1e3 * most[k]:.3g} {units[k]}" for k in far[:3])
        return (
            f"{self.gap.start:.4g} ... {self.gap.start + self.gap.duration:.4g} s, {named}{' ...' * (len(far) > 3)}, "
            f"{self.excess / rest:.2g} times as far as anywhere else"
        )


@dataclass(frozen=True)
class LeftOut:
    """Stretches that a calibration goes on without, one finding after the other."""

    gaps: tuple[Mapping[str, Sequence[tuple[float, float]]], ...] = ()
    """Of each finding: (start, duration) in s of the stretches of recordings, by name."""
    notes: tuple[str, ...] = ()

    def of(self, recordings: Sequence[Recording]) -> list[Recording]:
        """Recordings in parts between these stretches, each from where the robot was; the others are the same objects."""
        result = list(recordings)
        for found in self.gaps:
            parts = [parts_between(r, [Gap(*g) for g in found.get(r.name, ())], known=SETTLE) for r in result]
            result = [p for r, own in zip(result, parts, strict=True) for p in (own if r.name in found else [r])]
        return result

    def touches(self, recordings: Sequence[Recording]) -> bool:
        """Whether any of these has such a stretch."""
        return any(r.name in found for found in self.gaps for r in recordings)

    def sentences(self, done: bool) -> tuple[str, ...]:
        """What was found, and whether that was `done` without."""
        if not done:
            return tuple(f"refused, and so not left out: {note}" for note in self.notes)
        what = "That is left out, and it is replayed in parts, each from where the robot was measured to be"
        return tuple(f"{note}. {what} (--refuse {NAME}: it stays)" for note in self.notes)

    def and_also(self, found: LeftOut) -> LeftOut:
        """With what was found in the parts."""
        return LeftOut((*self.gaps, *found.gaps), (*self.notes, *found.notes))

    def kept_by(self, checkpoint: Callable[[dict[str, Any]], None] | None) -> Callable[[dict[str, Any]], None] | None:
        """A checkpoint that keeps this with the state of a search."""
        gaps = [{k: list(v) for k, v in g.items()} for g in self.gaps]
        state = {"gaps": gaps, "notes": list(self.notes)}
        return checkpoint if checkpoint is None or not self.gaps else lambda saved: checkpoint({**saved, NAME: state})

    @classmethod
    def kept_in(cls, state: Mapping[str, Any] | None) -> LeftOut:
        """What a checkpoint kept."""
        kept = (state or {}).get(NAME)
        return cls() if kept is None else cls(tuple(kept["gaps"]), tuple(kept["notes"]))


def deviations_of(problem: Problem, values: Array) -> list[Deviation]:
    """The problem's recordings of joints beside their replays with values (n,)."""
    if not any(s.channel == _JOINTS for s in problem.segments):
        return []
    residual = problem.residuals(values[None])[0]
    parts: dict[tuple[int, tuple[str, ...]], list[tuple[Array, Array, Array]]] = {}
    for s in problem.segments:
        if s.channel == _JOINTS:
            time = problem.trials[s.trial].observed[s.channel].time
            off = np.where(s.mask, np.abs(s.shaped(residual)), np.nan)
            parts.setdefault((s.recording, s.labels), []).append((time, off, s.scale))
    together = [
        Deviation(
            problem.recordings[k],
            labels,
            np.concatenate([t for t, _, _ in own]),
            np.concatenate([o for _, o, _ in own]),
            own[0][2],
        )
        for (k, labels), own in parts.items()
    ]
    return together if np.isfinite(residual).all() else []


def deviations_in(replays: Sequence[Replay], recordings: Sequence[Recording]) -> list[Deviation]:
    """Recordings of joints beside their replays `after`."""
    by_name = {r.name: r for r in recordings}
    return [
        Deviation(
            by_name[r.recording],
            r.labels,
            r.time + by_name[r.recording].start,
            np.abs(r.after - r.measured) / r.noise,
            r.noise,
        )
        for r in replays
        if r.channel == _JOINTS and r.noise.size and r.noise.all()
    ]


def disturbed(every: Sequence[Deviation], anew: Callable[[], Sequence[Deviation]] | None = None) -> LeftOut:
    """Stretches in which something acted on the robot that the model does not have; none of robots on a free base, whose
    replays part by chance. With what is seen in replays that begin `anew` every so often, only stretches that stand out
    there as well: a replay may part for good although nothing acted, as that of a pole that goes over the top once more.
    """
    if any(one.recording.has(name) for one in every for name in BASE):
        return LeftOut()
    found, rest = _outstanding(every)
    if found and anew is not None:
        short, _ = _outstanding(anew())
        found = [s for s in found if any(s.meets(t) for t in short)]
    own = {s.deviation.recording.name: [t for t in found if t.deviation is s.deviation] for s in found}
    gaps = {name: [(s.gap.start, s.gap.duration) for s in stretches] for name, stretches in own.items()}
    notes = tuple(
        f"in '{name}' something acted on the robot that the model does not have: a collision, a hand, drives that let go, or "
        "the log stood still "
        f"({'; '.join(s.words(rest) for s in stretches[:3])}{' ...' * (len(stretches) > 3)})"
        for name, stretches in own.items()
    )
    return LeftOut((gaps,) if gaps else (), notes)


def _outstanding(every: Sequence[Deviation]) -> tuple[list[_Stretch], float]:
    """Stretches that stand out, and how far joints are off anywhere else, in times of what is usual."""
    stretches, usual = _stretches(every)
    which, rest = outstanding([s.excess for s in stretches], usual)
    return sorted((stretches[k] for k in which), key=lambda s: s.first), rest


def _stretches(every: Sequence[Deviation]) -> tuple[list[_Stretch], float]:
    """Where joints are far off and may have been disturbed, and how far they are anywhere else, in times of what is usual."""
    usual = _by_label(
        every, [one.off for one in every], lambda v: max(float(np.nanmedian(v)), half_interval(share=0.5))
    )
    found, rest = list[_Stretch](), UNUSUAL
    for one in every:
        times = np.nan_to_num(one.off) / np.array([usual[label] for label in one.labels])
        own = joined(np.any(times > UNUSUAL, axis=1), one.time)
        lasting = sum(float(one.time[b] - one.time[a]) for a, b in own) > MOST * float(one.time[-1] - one.time[0])
        for first, last in own:
            most = times[first : last + 1].max(axis=0)
            begun = float(one.time[first] - one.time[0])
            if lasting or begun < 0.5 * LONG:  # another robot, or one of which it is unsure how its replay begins
                rest = max(rest, float(most.max()))
            else:
                found.append(_Stretch(one, first, last, most, float(most.max()) / _unusual(every, one, first, last)))
    return found, rest


def _unusual(every: Sequence[Deviation], seen: Deviation, first: int, last: int) -> float:
    """How many times as much as anywhere else was asked of some joint in a stretch; at least 1."""
    until = int(np.searchsorted(seen.time, seen.time[last] + LONG + 2.0 * CUBIC, side="right"))
    rest = [one.demand if one is not seen else np.delete(one.demand, np.s_[first:until], axis=0) for one in every]
    ratios = [1.0]
    for way in range(2):
        most = _by_label(
            every,
            [each[..., way] for each in rest],
            lambda values: float(values.max(initial=0.0)),
            lambda one: one.commands,
        )
        inside = seen.demand[first : last + 1, :, way].max(axis=0)
        ratios += [float(v) / max(most[label], _LEAST) for label, v in zip(seen.commands, inside, strict=True)]
    return max(ratios)


def _by_label(
    every: Sequence[Deviation], values: Sequence[Array], of: Callable[[Array], float],
    labels: Callable[[Deviation], Sequence[str]] = lambda one: one.labels,
) -> dict[str, float]:  # fmt: skip
    """One number for each joint (or other label), of its columns of the `values` (T, k) of all recordings."""
    columns: dict[str, list[Array]] = {}
    for one, each in zip(every, values, strict=True):
        for label, column in zip(labels(one), each.T, strict=True):
            columns.setdefault(label, []).append(column)
    return {label: of(np.concatenate(own)) for label, own in columns.items()}
