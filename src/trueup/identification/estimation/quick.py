# SPDX-License-Identifier: Apache-2.0
"""Quick fits of a basic model: which speeds to trust, whether a log can be what it says, what mistake would explain it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from trueup.arrays import Array, Integers
from trueup.errors import IdentificationError
from trueup.evidence import EXCERPT, FEWEST_PARTS, HALVED, without_each
from trueup.identification.estimation.belonging import strangers
from trueup.identification.estimation.blocks import blocks_of, numbered
from trueup.identification.estimation.diagnosis import (
    AS_GOOD,
    DOUBTFUL,
    POOR,
    Errors,
    Fit,
    Suspicion,
    grouped,
    mistakes,
    signs,
)
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.estimate import Estimate, least_squares
from trueup.identification.estimation.filtering import slow_cutoff
from trueup.identification.estimation.moments import moments_of, solve
from trueup.identification.estimation.motion import Log, Motion, Piece, log_of, pieces_of
from trueup.identification.estimation.pool import BASIC, Pool, pool_for
from trueup.identification.estimation.selection import TIME_BLOCKS
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.rows import Rows
from trueup.instant import STILL
from trueup.recording import Channel, Recording
from trueup.rounding import TINY
from trueup.samples import rms
from trueup.units import GRAVITY

FURTHEST = 0.2
"""rad: how far slopes hold. A turn that is known no better is not known; one that is larger is another mounting."""
_SMALL, _SURELY = 0.02, 0.5
"""Of a joint's torque, below which friction is not looked at; correlation with speed that is certain."""


def basic_columns(pool: Pool) -> Integers:
    """The columns of a model that fits any arm roughly: rotors, offsets, viscous and Coulomb friction."""
    return np.flatnonzero(pool.with_groups(*BASIC))


def measured_speed(logs: Sequence[Log], tree: KinematicTree, drives: Drives, cutoff: float, hold_out: float) -> bool:
    """Whether speeds as measured explain torque better than differences of positions; the share held out is not looked at."""
    if any(log.velocity is None for log in logs):
        return False
    motions = [logs[0].motion(cutoff, measured_speed=measured) for measured in (True, False)]
    fit = quick_fit(motions[0], tree, drives, cutoff, hold_out)
    return fit(motions[0]) <= fit(motions[1])


def doubts(
    logs: Sequence[Log], tree: KinematicTree, drives: Drives, pool: Pool, pieces: Sequence[Piece]
) -> list[str]:  # fmt: skip
    """Nothing where a basic model explains the torque; else what else might be wrong. Raises where a mistake explains it."""
    parts = [p.rows for p in pieces if not p.held_out]
    relative, driven = _rough(pool, parts)
    if relative < DOUBTFUL and not driven:
        return _strangers(logs, pool, pieces)
    alone = [_rough(pool, [part]) for part in parts] if len(parts) > 1 else [(relative, driven)]
    # Signs are looked for in every log, since one of them may have been logged otherwise; the rest in one: it takes long.
    first = max(range(len(logs)), key=lambda k: alone[k][0])
    first = first if HALVED * alone[first][0] > alone[0][0] else 0
    suspects = {k: own for k, (_, own) in enumerate(alone) if own} or ({first: driven} if driven else {})
    slow = slow_cutoff(logs[0].rate)
    motions = {k: logs[k].motion(slow, measured_speed=False) for k in (first, *suspects)}
    fits = {k: foretelling_fit(motion, tree, drives, slow) for k, motion in motions.items()}
    found = {k: s for k, own in suspects.items() if (s := signs(motions[k], tree, own, fits[k])).likely}
    if not _as_good_turned(pool, parts, {k: suspects[k] for k, s in found.items() if s.certain}, relative):
        found = {k: s for k, s in found.items() if not s.sure}
    every = [(logs[k].name, s) for k, s in found.items()]
    if relative >= DOUBTFUL and not any(s.certain for _, s in every):
        tried = mistakes(motions[first], tree, fits[first]), _hanging(motions[first], tree, drives, slow)
        every += [(logs[first].name, s) for s in tried if s is not None and s.likely]
    if certain := [f"recording '{name}': {s}" for name, s in every if s.certain]:
        raise IdentificationError(f"{'; '.join(grouped(certain))}. Correct that and identify again")
    notes = grouped(
        f"recording '{name}': {s}. Parts of it that were left out do not prove it: look whether it is so"
        for name, s in every
    )
    apart = _strangers(logs, pool, pieces)
    return [*notes, *apart] if apart or relative < POOR else [*notes, _poor(relative)]


def _rough(pool: Pool, parts: Sequence[Rows]) -> tuple[float, dict[int, float]]:
    """The relative error of a basic model of some rows, and the joints that its friction would drive."""
    power = np.maximum(sum(np.mean(r.torque**2, axis=0) for r in parts), TINY)
    rough = least_squares(parts, basic_columns(pool), 1.0 / power)
    return _relative(parts, rough), _driven(pool, parts, rough)


def _as_good_turned(
    pool: Pool, parts: Sequence[Rows], driven: Mapping[int, Mapping[int, float]], relative: float
) -> bool:
    """Whether all logs together are explained as well with these torques of some of them turned: the others speak for it."""
    turned = list(parts)
    for k, joints in driven.items():
        sign = np.ones(parts[k].torque.shape[1])
        sign[list(joints)] = -1.0
        turned[k] = replace(parts[k], torque=parts[k].torque * sign)
    return len(parts) < 2 or _rough(pool, turned)[0] <= AS_GOOD * relative


def _strangers(logs: Sequence[Log], pool: Pool, pieces: Sequence[Piece]) -> list[str]:
    """What to say of recordings that do not belong to the others; of whole ones that were held out, too."""
    fitted, last = {log.name for log in logs}, pool.model.tree.n - 1
    whole = [p for p in pieces if not (p.held_out and p.whole.name in fitted)]
    return strangers(
        [p.whole.name for p in whole], [p.rows for p in whole], basic_columns(pool), 10 * last + np.arange(10),
        pool.model.tree.links[last], weighed=all(log.measured for log in logs),
    )  # fmt: skip


def _poor(relative: float) -> str:
    """What to say of torque that stays unexplained."""
    return (
        f"a rigid arm with friction explains little of this torque ({100 * relative:.0f} % of it is left): is it the right "
        "model file, are torques measured rather than commanded, are joints in the right order, did the arm touch "
        "a table, a fixture, a hand?"
    )


def quick_fit(
    motion: Motion, tree: KinematicTree, drives: Drives, cutoff: float, hold_out: float = 0.0
) -> Callable[[Motion], float]:
    """A fit of a basic model that can be had many times: from a motion like this one to its relative error."""
    fit = foretelling_fit(motion, tree, drives, cutoff, hold_out, parts=(1,))
    return lambda changed: float(np.sqrt(fit(changed)[0].sum()))


def foretelling_fit(
    motion: Motion, tree: KinematicTree, drives: Drives, cutoff: float, hold_out: float = 0.0,
    parts: Sequence[int] = (1, FEWEST_PARTS, TIME_BLOCKS),
) -> Fit:  # fmt: skip
    """As `quick_fit`, to the squared relative errors of so many `parts`, each foretold by the others; of one, as fitted. A
    mistake is looked for in all, in as few as evidence allows, and in as many as structures are asked in.
    """
    pool = pool_for(tree, drives.coupling, [motion], springs=drives.springs)
    model, active = pool.basic()

    def errors(rows: Rows, count: int) -> Array:
        moments = moments_of(blocks_of([rows], numbered([rows], count), 0.0))
        power = np.maximum(moments.square.sum(axis=0), TINY)
        gram, cross = moments.weighted(1.0 / power)
        if count > 1:
            gram, cross = without_each(gram), without_each(cross)
        x = np.zeros((len(gram), model.p))
        x[:, active] = solve(gram[:, active[:, None], active], cross[:, active], np.zeros(len(active)))
        return np.asarray((moments.errors(x) / power).mean(axis=1))

    def fit(changed: Motion) -> Errors:
        rows = pieces_of(changed, model, cutoff, hold_out)[0].rows
        return tuple(errors(rows, count) for count in parts)

    return fit


def rough_error(tree: KinematicTree, recording: Recording, channels: dict[str, Channel]) -> float:
    """Relative error of a rough model of position and torque; infinite where there is no motion to fit."""
    start = float(channels["position"].time[0])
    part = recording.replace(channels=channels).slice(start, start + EXCERPT)
    drives = Drives.direct(tree.joints)
    try:
        log = log_of(part, tree, drives)
        slow = slow_cutoff(log.rate)
        motion = log.motion(slow, measured_speed=False)
        return quick_fit(motion, tree, drives, slow)(motion)
    except IdentificationError:
        return np.inf


def _hanging(motion: Motion, tree: KinematicTree, drives: Drives, cutoff: float) -> Suspicion | None:
    """The direction of gravity that the torque fits best: of an arm on a wall, a ceiling, a slope; none is one, too.

    None where it is so near to the file's that `leaning` finds it.
    """
    size = float(np.linalg.norm(tree.gravity)) or GRAVITY

    def error(gravity: Array) -> float:
        return quick_fit(motion, tree.replace(gravity=gravity), drives, cutoff)(motion)

    def suspected(gravity: Array, said: str) -> Suspicion:
        fits = (foretelling_fit(motion, tree.replace(gravity=g), drives, cutoff) for g in (tree.gravity, gravity))
        before, after = (fit(motion) for fit in fits)
        return Suspicion(said, before, after)

    relative = error(np.asarray(tree.gravity))
    directions = [sign * size * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
    tried = [(error(g), g) for g in directions if g @ tree.gravity < 0.9 * size**2]
    best, gravity = min([(relative, np.asarray(tree.gravity)), *tried], key=lambda entry: entry[0])
    step = 2.0 * FURTHEST
    while step > STILL:
        before = np.inf
        while best < before:
            before, across = best, np.linalg.svd(gravity[None])[2][1:]  # two directions at right angles to it
            turned = [np.cos(step) * gravity + sign * np.sin(step) * size * a for a in across for sign in (1.0, -1.0)]
            best, gravity = min([(best, gravity), *((error(g), g) for g in turned)], key=lambda entry: entry[0])
        step *= HALVED**2
    best, gravity = min([(best, gravity), (error(-gravity), -gravity)], key=lambda entry: entry[0])
    if error(np.zeros(3)) < min(best, HALVED * relative):
        said = "the torque seems to hold no gravity, as where a controller takes it out: identify with --gravity 0 0 0"
        return suspected(np.zeros(3), said)
    if gravity @ tree.gravity > np.cos(FURTHEST) * size**2:
        return None
    x, y, z = (round(float(g), 2) + 0.0 for g in gravity)
    said = f"the arm seems to be mounted otherwise than the model file says: try --gravity {x:g} {y:g} {z:g}, or near"
    return suspected(gravity, said)


def _driven(pool: Pool, rows: Sequence[Rows], estimate: Estimate) -> dict[int, float]:
    """Joints whose friction drives them, as none does (their torque or position has the wrong sign), and its share."""
    found, x = dict[int, float](), estimate.parameters
    for j, at in enumerate(zip(pool.groups[BASIC[-2]], pool.groups[BASIC[-1]], strict=True)):
        values = [np.concatenate([r.values[j][int(np.flatnonzero(r.columns[j] == k)[0])] for r in rows]) for k in at]
        friction, speed = x[list(at)] @ np.array(values), values[0]
        size = float(rms(friction))
        torque = float(rms(np.concatenate([r.torque[:, j] for r in rows])))
        if size > _SMALL * torque and np.mean(friction * speed) < -_SURELY * size * float(rms(speed)):
            found[j] = size / max(torque, TINY)
    return found


def _relative(rows: Sequence[Rows], estimate: Estimate) -> float:
    """Relative error, joints weighed by what they carry: no joint of little torque is drowned."""
    errors = np.concatenate([r.torque - r.predict(estimate.parameters) for r in rows])
    torque = np.concatenate([r.torque for r in rows])
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=0) / np.maximum(np.sum(torque**2, axis=0), TINY))))
