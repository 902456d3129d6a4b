# SPDX-License-Identifier: Apache-2.0
"""Stretches of logs in which something acted on the arm that no model of it has: a table, a fixture, a hand.

Least squares share out what a contact pushed among bodies and friction. Fitted to the half of the samples that agree best
(P. Rousseeuw, "Least median of squares regression", JASA 79, 1984, with the concentration steps of P. Rousseeuw, K. van
Driessen, "Computing LTS regression for large data sets", 2006), a basic model leaves there what acted. Where it leaves far
more than anywhere else, although the arm moved there as it did elsewhere, the arm was not by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.errors import IdentificationError
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.filtering import slow_cutoff
from trueup.identification.estimation.moments import moments_of, solve
from trueup.identification.estimation.motion import Log, pieces_of
from trueup.identification.estimation.pool import pool_for
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.rows import Rows
from trueup.inspection.outstanding import NAME, joined, outstanding
from trueup.instant import HARDLY
from trueup.noise import UNUSUAL, spread
from trueup.rounding import PRINTED, TINY
from trueup.samples import MOST

_Stretch = tuple[int, int, int]
"""The recording, first and last of its samples."""


@dataclass(frozen=True, eq=False)
class _Looked:
    """Logs beside a basic model, sample by sample."""

    logs: Sequence[Log]
    parts: Sequence[Rows]
    speeds: Sequence[Array]
    """(S, n) of each log, without sign."""
    active: Integers
    """Columns of the model that torque can tell apart."""
    body: Integers
    """Those of the last link."""

    @cached_property
    def moving(self) -> list[Mask]:
        """(S, n) of each log: whether a joint moves fast enough that its friction is known."""
        top = np.concatenate(self.speeds).max(axis=0)
        return [v > HARDLY * top for v in self.speeds]

    @cached_property
    def power(self) -> Array:
        """(n,) squared torque of each joint."""
        return np.maximum(np.mean(np.concatenate([r.torque for r in self.parts]) ** 2, axis=0), TINY)

    def times(
        self, inside: Sequence[Mask], load: Sequence[Mask] | None = None, usual: Array | None = None
    ) -> list[Array]:
        """(S, n) how far each joint is off a fit to the samples `inside` (S,), in times of what is `usual` (n,) (there,
        without it); a joint that rests never is. With a body more at the last link in the samples `load`.
        """
        own = self.usual(inside) if usual is None else usual
        return [np.abs(e) / own * w for e, w in zip(self._errors(inside, load, own**-2.0), self.moving, strict=True)]

    def usual(self, inside: Sequence[Mask]) -> Array:
        """(n,) standard deviation of each joint's errors in the samples `inside`, where a fit weighs joints by them."""
        size = np.sqrt(self.power)
        known, usual = [w & i[:, None] for w, i in zip(self.moving, inside, strict=True)], size
        for _ in range(3):
            errors = self._errors(inside, None, usual**-2.0)
            each = [
                np.concatenate([e[k[:, j], j] for e, k in zip(errors, known, strict=True)]) for j in range(len(size))
            ]
            usual = np.maximum([float(spread(e)) if len(e) else 0.0 for e in each], PRINTED * size)
        return usual

    def _errors(self, inside: Sequence[Mask], load: Sequence[Mask] | None, weights: Array) -> list[Array]:
        parts = (
            self.parts if load is None else [_laden(r, self.body, own) for r, own in zip(self.parts, load, strict=True)]
        )
        active = np.concatenate([self.active, np.arange(self.parts[0].p, parts[0].p)])
        chosen = [
            replace(r, values=tuple(x * k for x, k in zip(r.values, keep.T, strict=True)), torque=r.torque * keep)
            for r, keep in zip(parts, (w & i[:, None] for w, i in zip(self.moving, inside, strict=True)), strict=True)
        ]
        moments = moments_of(chosen).only(active)
        gram, cross = (x.sum(axis=0) for x in moments.weighted(weights / weights.mean()))
        x = np.zeros(parts[0].p)
        x[active] = moments.parameters(solve(gram, cross, np.zeros(len(active))))
        return [r.torque - r.predict(x) for r in parts]

    def agreeing(self) -> list[Mask]:
        """The half of the samples that agree best with a fit to themselves, of those in which a joint moves."""
        inside = moves = [np.asarray(w.any(axis=1)) for w in self.moving]
        seen = set[bytes]()
        while (chosen := np.concatenate(inside).tobytes()) not in seen:  # samples chosen by a fit to them: they settle
            seen.add(chosen)
            off = [
                np.sqrt(np.sum(t**2, axis=1) / np.maximum(w.sum(axis=1), 1))
                for t, w in zip(self.times(inside), self.moving, strict=True)
            ]
            most = float(np.quantile(np.concatenate([o[m] for o, m in zip(off, moves, strict=True)]), MOST))
            inside = [m & (o <= most) for o, m in zip(off, moves, strict=True)]
        return inside

    def outside(self, stretches: Sequence[_Stretch]) -> list[Mask]:
        """(S,) of each log: the samples in none of the stretches."""
        free = [np.ones(r.length, dtype=bool) for r in self.parts]
        for k, first, last in stretches:
            free[k][first : last + 1] = False
        return free

    def standing_out(self, inside: Sequence[Mask]) -> tuple[list[_Stretch], float]:
        """Stretches that are far off a fit to the samples `inside`, and how far all else is at most.

        Friction of another form leaves more than is usual at every reversal: where that joins what stands out to most of a
        recording, `UNUSUAL` times what is usual parts stretches.
        """
        off = [t.max(axis=1) for t in self.times(inside)]
        for level in (UNUSUAL, UNUSUAL * UNUSUAL):
            found, rest = self._beyond(off, level)
            if all(self._share([s for s in found if s[0] == k]) <= MOST for k, _, _ in found):
                return found, rest
        return [], rest

    def _beyond(self, off: Sequence[Array], level: float) -> tuple[list[_Stretch], float]:
        """Of the stretches in which joints are off by more than a level those that stand out, and how far the others are."""
        every = [(k, *ends) for k, own in enumerate(off) for ends in joined(own > level, self.parts[k].time)]
        free = self.outside(every)
        if not any(f.any() for f in free):  # what is off everywhere stands out from nothing
            return [], float(np.concatenate(off).max(initial=0.0))
        sizes = [float(off[k][a : b + 1].max()) / self._unusual((k, a, b), free) for k, a, b in every]
        which, rest = outstanding(sizes, level)
        return sorted(every[i] for i in which), rest

    def _share(self, stretches: Sequence[_Stretch]) -> float:
        """Of their recording that these stretches last."""
        time = self.parts[stretches[0][0]].time
        return sum(float(time[b] - time[a]) for _, a, b in stretches) / float(time[-1] - time[0])

    def _unusual(self, stretch: _Stretch, free: Sequence[Mask]) -> float:
        """How many times as fast as in the samples `free` some joint is in a stretch, squared as torque of inertia grows with
        a motion's pace; at least 1. Accelerations are not asked: what touches changes them.
        """
        k, first, last = stretch
        rest = np.concatenate([v[f] for v, f in zip(self.speeds, free, strict=True)]).max(axis=0)
        return max(1.0, float((self.speeds[k][first : last + 1].max(axis=0) / np.maximum(rest, TINY)).max()) ** 2)

    def outstanding(self) -> tuple[list[_Stretch], float]:
        """Stretches that stand out from a fit to all else, and from every fit that takes one of them in."""
        stretches, rest = self.standing_out(self.agreeing())
        seen = list[list[_Stretch]]()
        while stretches not in seen:
            seen.append(stretches)
            stretches, rest = self.standing_out(self.outside(stretches))
        return [s for s in stretches if not self._explained(s, stretches, rest)], rest

    def _explained(self, stretch: _Stretch, stretches: Sequence[_Stretch], rest: float) -> bool:
        """Whether a fit that takes a stretch in has both what is there and all else: motion that nothing else showed."""
        k, first, last = stretch
        free = self.outside(stretches)
        usual = self.usual(free)
        free[k][first : last + 1] = True
        times = [t.max(axis=1) for t in self.times(free, usual=usual)]
        own = float(times[k][first : last + 1].max())
        free[k][first : last + 1] = False
        return max(own, *(float(t[f].max(initial=0.0)) for t, f in zip(times, free, strict=True))) <= UNUSUAL * rest

    def loaded(self, stretches: Sequence[_Stretch]) -> bool:
        """Whether a body more at the last link explains most of what stands out: a load, which is said elsewhere."""
        free = self.outside(stretches)
        held, everything, usual = [~f for f in free], [np.ones(len(f), dtype=bool) for f in free], self.usual(free)
        without, with_it = (
            np.concatenate([t.max(axis=1)[h] for t, h in zip(times, held, strict=True)])
            for times in (self.times(free, None, usual), self.times(everything, held, usual))
        )
        return float(np.median(with_it)) < float(np.median(without)) / UNUSUAL

    def words(self, stretches: Sequence[_Stretch], rest: float) -> str:
        """Of each recording that was disturbed: when, and how many times as far off it is."""
        times, said = self.times(self.outside(stretches)), list[str]()
        for k in dict.fromkeys(s[0] for s in stretches):
            own, time = [(first, last) for of, first, last in stretches if of == k], self.parts[k].time
            spans = [
                f"{time[a]:.4g} ... {time[b]:.4g} s ({times[k][a : b + 1].max() / rest:.0f} times)" for a, b in own
            ]
            said.append(f"recording '{self.logs[k].name}' {', '.join(spans[:3])}{' ...' * (len(spans) > 3)}")
        return "; ".join(said)


Spans = dict[str, list[tuple[float, float]]]
"""First and last instant in s of stretches, by the name of a recording."""


def disturbed(logs: Sequence[Log], tree: KinematicTree, drives: Drives) -> tuple[Spans, str]:
    """Stretches of logs in which something acted on the arm, and what to say of them; none where a load explains them, which
    is said elsewhere, or where a log is too short to tell.
    """
    looked = _looked(logs, tree, drives)
    stretches, rest = ([], UNUSUAL) if looked is None else looked.outstanding()
    if looked is None or not stretches or looked.loaded(stretches):
        return {}, ""
    spans: Spans = {}
    for k, first, last in stretches:
        time = looked.parts[k].time
        spans.setdefault(logs[k].name, []).append((float(time[first]), float(time[last])))
    return spans, (
        "something acted on the arm that no model of it has: a table or a fixture, a hand, another load. Torque is further "
        f"off there than anywhere else: {looked.words(stretches, rest)}"
    )


def without_disturbed(
    logs: Sequence[Log], judged: Sequence[Log], tree: KinematicTree, drives: Drives, *, refused: bool = False
) -> tuple[list[Log], list[Log], list[str]]:  # fmt: skip
    """Logs that are fitted and those that judge, without stretches in which something acted on the arm (see `disturbed`)
    unless that is `refused`, and what to say of them.
    """
    spans, note = disturbed([*logs, *judged], tree, drives)
    if not spans or refused:
        return list(logs), list(judged), [f"refused, and so not left out: {note}"] if spans else []
    fitted, others = (
        [replace(x, gaps=tuple(sorted({*x.gaps, *spans[x.name]}))) if x.name in spans else x for x in each]
        for each in (logs, judged)
    )
    said = f"{note}. That is left out, of what the model is judged by too (--refuse {NAME}: it stays)"
    return fitted, others, [said]


def _looked(logs: Sequence[Log], tree: KinematicTree, drives: Drives) -> _Looked | None:
    """The logs beside a basic model; None where one of them is too short."""
    motions = [log.motion(slow_cutoff(log.rate), measured_speed=False) for log in logs]
    model, active = pool_for(tree, drives.coupling, motions, springs=drives.springs).basic()
    try:
        pieces = [pieces_of(m, model, slow_cutoff(x.rate), 0.0)[0] for m, x in zip(motions, logs, strict=True)]
    except IdentificationError:
        return None
    speeds = [np.abs(p.motion.v) for p in pieces]
    last = 10 * (tree.n - 1) + np.arange(10)
    return _Looked(logs, [p.rows for p in pieces], speeds, active, last)


def _laden(rows: Rows, body: Integers, where: Mask) -> Rows:
    """Rows with the columns of a body once more behind all, zero but at the samples `where` (S,)."""
    columns, values = list[Integers](), list[Array]()
    for c, v in zip(rows.columns, rows.values, strict=True):
        own = np.isin(c, body)
        columns.append(np.concatenate([c, rows.p + np.searchsorted(body, c[own])]))
        values.append(np.vstack([v, v[own] * where]))
    return replace(rows, columns=tuple(columns), values=tuple(values), p=rows.p + len(body), shrink=0.0)
