# SPDX-License-Identifier: Apache-2.0
"""Which recordings, or parts of them, do not belong to the others: another load, a hand that moved the arm, other signs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.errors import listed
from trueup.evidence import half_interval, jackknife, without_each
from trueup.identification.estimation.blocks import FINER, numbered
from trueup.identification.estimation.diagnosis import POOR, Suspicion
from trueup.identification.estimation.moments import Moments, moments_of, solve
from trueup.identification.estimation.selection import TIME_BLOCKS
from trueup.identification.rows import Rows
from trueup.rounding import TINY
from trueup.samples import stretches_of

_NONE = np.array([], dtype=np.int64)
_ADVICE = "Identify recordings with one load together, and others by themselves"


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Recordings cut into blocks; a block is foretold by others alone."""

    parts: Sequence[Rows]
    active: Integers
    """Columns of a basic model."""
    power: Array
    """(n,) squared torque of each joint: errors are relative to it."""
    count: int = TIME_BLOCKS
    """About how many."""

    @cached_property
    def numbers(self) -> list[Integers]:
        """(S,) of each recording: the block of each sample."""
        return numbered(self.parts, self.count)

    @cached_property
    def owner(self) -> Integers:
        """(B,) the recording of each block."""
        return np.repeat(np.arange(len(self.parts)), [len(np.unique(own)) for own in self.numbers])

    def moments(self, laden: Sequence[int] = (), body: Integers = _NONE) -> Moments:
        """Of the basic model, and of columns that give some recordings, `laden`, a `body` of their own."""
        columns = np.unique([*self.active.tolist(), *body])
        rows = [_with_own(r, columns, body, own=k in laden) for k, r in enumerate(self.parts)]
        blocks = [r.part(own == b) for r, own in zip(rows, self.numbers, strict=True) for b in np.unique(own)]
        fitted = [*self.active.tolist(), *range(self.parts[0].p, rows[0].p)]
        return moments_of(blocks).only(fitted)

    def foretold(self, moments: Moments, among: Mask) -> tuple[Array, Array]:
        """(B,) squared relative errors of the blocks `among` (B,), and (B, m) the scaled parameters that foretell each:
        those of all other blocks among them.
        """
        some = moments.take(np.flatnonzero(among))
        gram, cross = some.weighted(1.0 / self.power)
        x = solve(without_each(gram), without_each(cross), np.zeros(cross.shape[1]))
        return np.asarray((some.errors(x) / self.power).mean(axis=1)), x

    def relative(self, errors: Array, among: Mask) -> float:
        """Relative error of blocks, as a share of their own torque."""
        own = self.plain.square[among].sum(axis=0) / self.power
        return float(np.sqrt(errors.sum() / max(float(own.mean()), TINY)))

    @cached_property
    def plain(self) -> Moments:
        """Of the basic model that all recordings share."""
        return self.moments()


def strangers(
    names: Sequence[str], parts: Sequence[Rows], active: Integers, body: Integers, link: str, *, weighed: bool
) -> list[str]:  # fmt: skip
    """What to say of recordings without which the others are foretold much better, by the rule of `Suspicion`; or, where
    there are none, of a load that the arm carried in stretches of them.

    A fit to all of them is a compromise that fits none (G. Chow, "Tests of equality between sets of coefficients",
    Econometrica 28(3), 1960, with left-out blocks in place of the F test, since errors last and models miss something).
    `active`: columns of a basic model, `body` the ten of the last `link`, `weighed`: whether torques are in N m.
    """
    power = np.maximum(sum(np.sum(r.torque**2, axis=0) for r in parts), TINY)
    blocks = _Blocks(parts, active, power)
    out = _apart(blocks)
    if not out:
        one = _one_laden(names, blocks, body, link, weighed=weighed)
        return one or _in_between(names, replace(blocks, count=FINER * TIME_BLOCKS), body, link, weighed=weighed)
    blamed = _to_blame(blocks, out)
    loads = (
        _with_load(names, blocks, k, body, link, weighed=weighed) for k in dict.fromkeys((tuple(out), tuple(blamed)))
    )
    return [next(filter(None, loads), "") or _note(names, blocks, blamed)]


def _apart(blocks: _Blocks) -> list[int]:
    """The fewest recordings, at most half of them, without which the others are foretold much better."""
    everything, out = np.ones(len(blocks.owner), dtype=bool), list[int]()
    together = blocks.foretold(blocks.plain, everything)[0]
    while 2 * (len(out) + 1) <= len(blocks.parts):
        tried = []
        for k in (k for k in range(len(blocks.parts)) if k not in out):
            rest = ~np.isin(blocks.owner, [*out, k])
            errors = blocks.foretold(blocks.plain, rest)[0]
            tried.append((blocks.relative(errors, rest), k, Suspicion("", (together[rest],), (errors,))))
        _, worst, without = min(tried, key=lambda each: each[0])
        out.append(worst)
        if without.likely:
            return sorted(out)
    return []


def _to_blame(blocks: _Blocks, out: Sequence[int]) -> list[int]:
    """Those of recordings that were left out together which alone make the others foretold much worse; all where none does.

    Where a base leans too, or the model lacks something else, errors may have to lose more than the one of another load.
    """
    rest = ~np.isin(blocks.owner, out)
    without = blocks.foretold(blocks.plain, rest)[0]

    def worse(k: int) -> bool:
        among = rest | (blocks.owner == k)
        return Suspicion("", (blocks.foretold(blocks.plain, among)[0][rest[among]],), (without,)).likely

    return [k for k in out if worse(k)] or list(out)


def _one_laden(names: Sequence[str], blocks: _Blocks, body: Integers, link: str, *, weighed: bool) -> list[str]:
    """What to say of one recording with a load that spoils the others too little to be missed there; [] without one."""
    if len(names) < 2:
        return []
    everything = np.ones(len(blocks.owner), dtype=bool)
    errors = [blocks.foretold(blocks.moments([k], body), everything)[0].sum() for k in range(len(names))]
    said = _with_load(names, blocks, [int(np.argmin(errors))], body, link, weighed=weighed, little=True)
    return [said] if said else []


def _with_load(
    names: Sequence[str],
    blocks: _Blocks,
    out: Sequence[int],
    body: Integers,
    link: str,
    *,
    weighed: bool,
    little: bool = False,
) -> str:
    """What to say where a load at the last link explains what is different; nothing where it does not. A `little` one needs
    to explain its own recordings alone, and its mass must be certain.
    """
    everything = np.ones(len(blocks.owner), dtype=bool)
    before = blocks.foretold(blocks.plain, everything)[0]
    moments = blocks.moments(out, body)
    after, each = blocks.foretold(moments, everything)
    of, apart = np.isin(blocks.owner, out), np.empty_like(before)
    for part in (of, ~of):
        apart[part] = blocks.foretold(blocks.plain, part)[0]
    halved = (Suspicion("", (before[part],), (after[part],)).likely for part in ((of,) if little else (of, ~of)))
    if not all(halved) or Suspicion("", (after,), (apart,)).likely:  # what else differs matters more
        return ""
    at = len(blocks.active)
    masses = each[:, at] / max(float(moments.scale[at]), TINY)
    mass, doubt = float(masses.mean()), half_interval(len(masses)) * float(jackknife(masses))
    more = f"{abs(mass):.3g} +- {doubt:.2g} kg more" if weighed and doubt < abs(mass) else "a body of its own"
    if little and not doubt < abs(mass):
        return ""
    laden = out if mass > 0.0 else [k for k in range(len(names)) if k not in out]
    return (
        f"{_recordings(names, laden)} carried another load than the others: with {more} at {link} the error of all "
        f"would go from {_percent(blocks.relative(before, everything))} to {_percent(blocks.relative(after, everything))} of "
        f"the torque. {_ADVICE}"
    )


def _in_between(names: Sequence[str], blocks: _Blocks, body: Integers, link: str, *, weighed: bool) -> list[str]:
    """What to say of a load that was taken up and put down within recordings; nothing where it does not explain much."""
    everything = np.ones(len(blocks.owner), dtype=bool)
    moments, at = blocks.moments(range(len(blocks.parts)), body), len(blocks.active)
    laden = min((_sorted(blocks, moments, k) for k in range(0, len(everything), FINER)), key=lambda each: each[0])[1]
    before = blocks.foretold(blocks.plain, everything)[0]
    after, each = blocks.foretold(_only_in(moments, at, laden), everything)
    if laden.all() or not all(
        np.any(part) and Suspicion("", (before[part],), (after[part],)).likely for part in (laden, ~laden)
    ):
        return []
    masses = each[:, at] / max(float(moments.scale[at]), TINY)
    mass, doubt = float(masses.mean()), half_interval(len(masses)) * float(jackknife(masses))
    more = f"{abs(mass):.3g} +- {doubt:.2g} kg more" if weighed and doubt < abs(mass) else "a body of its own"
    spans = _spans(names, blocks, laden if mass > 0.0 else ~laden)
    return [
        f"the arm carried another load in parts of its recordings (about {spans}): with {more} at {link} there the error of "
        f"all would go from {_percent(blocks.relative(before, everything))} to "
        f"{_percent(blocks.relative(after, everything))} of the torque. Cut recordings where the load changes, and identify "
        "those with one load together"
    ]


def _only_in(moments: Moments, at: int, laden: Mask) -> Moments:
    """Moments whose columns from `at` on, those of a load, count in blocks that are `laden` (B,)."""
    there = np.ones((len(laden), moments.gram.shape[-1]))
    there[~laden, at:] = 0.0
    gram = moments.gram * there[:, None, :, None] * there[:, None, None, :]
    return replace(moments, gram=gram, cross=moments.cross * there[:, None])


def _sorted(blocks: _Blocks, moments: Moments, first: int) -> tuple[float, Mask]:
    """Which blocks (B,) have a load, begun with the `first` alone, and the error of all then: each is sorted to where the fit
    explains it better, and the fit made anew.
    """
    at, laden = len(blocks.active), np.arange(len(blocks.owner)) == first
    error = np.inf
    for _ in laden:  # sorted and fitted anew in turns they settle in three or four
        gram, cross = _only_in(moments, at, laden).weighted(1.0 / blocks.power)
        x = solve(gram.sum(axis=0), cross.sum(axis=0), np.zeros(cross.shape[1]))
        bare = np.where(np.arange(len(x)) < at, x, 0.0)
        with_it, without = ((moments.errors(each) / blocks.power).mean(axis=1) for each in (x, bare))
        error, sorted_anew = float(np.minimum(with_it, without).sum()), with_it < without
        if np.array_equal(sorted_anew, laden):
            break
        laden = sorted_anew
    return error, laden


def _spans(names: Sequence[str], blocks: _Blocks, laden: Mask) -> str:
    """Where blocks (B,) lie, in words."""
    said, first = list[str](), 0
    for name, rows, numbers in zip(names, blocks.parts, blocks.numbers, strict=True):
        own = np.unique(numbers)
        inside = laden[first : first + len(own)][np.searchsorted(own, numbers)]
        ends = [(rows.time[a], rows.time[b - 1]) for a, b in stretches_of(inside)]
        said += [f"'{name}' {a:.3g} ... {b:.3g} s" for a, b in ends]
        first += len(own)
    return listed(said)


def _note(names: Sequence[str], blocks: _Blocks, out: Sequence[int]) -> str:
    """What to say of recordings that differ from the others by more than a load."""
    of = np.isin(blocks.owner, out)
    together = blocks.foretold(blocks.plain, np.ones(len(of), dtype=bool))[0]
    alone, rest = (blocks.foretold(blocks.plain, part)[0] for part in (of, ~of))
    own, others = blocks.relative(alone, of), blocks.relative(rest, ~of)
    theirs, these = _recordings(names, [k for k in range(len(names)) if k not in out]), _recordings(names, out)
    if 2 * len(out) == len(names) and own < POOR and Suspicion("", (together[of],), (alone,)).likely:
        return (
            f"{theirs} and {these} contradict one another: {_percent(blocks.relative(together, of | ~of))} of their torque "
            f"is left together, {_percent(others)} and {_percent(own)} by themselves; was the arm moved by hand in one of "
            f"them, do signs, order of joints, mounting or load differ? {_ADVICE}"
        )
    several = len(out) > 1
    it, itself, its = ("them", "themselves", "their") if several else ("it", "itself", "its")
    return (
        f"{these} fit{'' if several else 's'} badly beside the others: without {it} {_percent(others)} of the torque of "
        f"{theirs} is left, with {it} {_percent(blocks.relative(together[~of], ~of))}; by {itself} "
        f"{_percent(own)} of {its} own. Was the arm moved by hand there, did it touch something, "
        f"or were units, signs, mounting or load others? Leave {it} out and identify again"
    )


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 1.0 else "nearly all"


def _recordings(names: Sequence[str], which: Sequence[int]) -> str:
    return f"recording{'s' if len(which) > 1 else ''} {listed([repr(names[k]) for k in which])}"


def _with_own(rows: Rows, columns: Integers, body: Integers, *, own: bool) -> Rows:
    """Rows with some of their columns, and those of a body once more behind all, zero where it is not their `own`."""
    kept, values = [], []
    again = {k: rows.p + i for i, k in enumerate(body)}
    for c, v in zip(rows.columns, rows.values, strict=True):
        at, twice = np.isin(c, columns), np.isin(c, list(body)) & own
        kept.append(np.concatenate([c[at], np.array([again[int(k)] for k in c[twice]], dtype=c.dtype)]))
        values.append(np.vstack([v[at], v[twice]]))
    return replace(rows, columns=tuple(kept), values=tuple(values), p=rows.p + len(body), shrink=0.0)
