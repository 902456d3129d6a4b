# SPDX-License-Identifier: Apache-2.0
"""Whether torque and position were logged at the same instant: the shift in time at which a model explains torque best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueup.arrays import Array, Integers
from trueup.evidence import evidence, jackknife
from trueup.identification.estimation.estimate import Estimate, least_squares
from trueup.identification.estimation.filtering import moved, stretches
from trueup.identification.estimation.moments import RIDGE, solve
from trueup.identification.estimation.result import Alignment
from trueup.identification.estimation.selection import TIME_BLOCKS
from trueup.identification.rows import Rows
from trueup.instant import usual_step
from trueup.rounding import TINY

REACH = 0.06
"""s that are looked at on both sides."""


def find_shift(rows: Sequence[Rows], active: Integers, weights: Array, log_rate: float) -> Alignment:
    """The shift of torque against position (s, positive: torque comes late) and its standard deviation by jackknife.

    `rows` as filtered; they oversample the cut-off, so that torque can be read between samples. The squared error is
    looked at over a grid of shifts, each with its own fit, and its least value found by a parabola.
    """
    step = usual_step(rows[0].time)
    reach = min(REACH, 0.1 * step * rows[0].length)
    middle = max(round(reach / (0.5 * step)), 12)
    shifts = np.linspace(-reach, reach, 2 * middle + 1)
    loss = _losses(rows, active, weights, shifts)  # (blocks, shifts)
    whole = loss.sum(axis=0)
    least = int(np.argmin(whole))
    each = np.array([_lowest(shifts, whole - one) for one in loss])
    deviation = float(jackknife(each))
    shift, inside = _lowest(shifts, whole), 0 < least < len(shifts) - 1
    # Where the parabola is lowest: on a grid coarser than the shift nothing would be gained by it.
    before, after = loss[:, middle], np.maximum(_at(shifts, loss, least, shift), 0.0)
    clear = inside and evidence(np.sqrt(before), np.sqrt(after), before).holds
    gain = 1.0 - float(after.sum()) / max(float(before.sum()), TINY)
    return Alignment(shift, deviation if inside else float("inf"), log_rate, clear, max(gain, 0.0))


def shifted(rows: Rows, shift: float) -> Rows:
    """Rows with their torque taken `shift` s later, so that torque that came late fits its position."""
    step = usual_step(rows.time)
    return replace(rows, torque=np.concatenate([moved(rows.torque[s], shift / step) for s in stretches(rows.time)]))


def with_doubtful_clock(estimate: Estimate, rows: Sequence[Rows], alignment: Alignment | None) -> Estimate:
    """The estimate with deviations that count how far the shift is known: what one standard deviation of it moves.

    K. Murphy and R. Topel, "Estimation and inference in two-step econometric models", J. Business & Economic Statistics
    3(4), 1985: what a first step found is as doubtful in the second.
    """
    if alignment is None or not np.isfinite(alignment.deviation):
        return estimate
    late, early = (
        least_squares(
            [shifted(r, way * alignment.deviation) for r in rows],
            estimate.active,
            estimate.weights,
            trust=estimate.trust,
        ).parameters
        for way in (0.5, -0.5)
    )
    return replace(estimate, covariance=estimate.covariance + np.outer(late - early, late - early))


def _losses(rows: Sequence[Rows], active: Integers, weights: Array, shifts: Array) -> Array:
    """(blocks, shifts) weighted squared errors, each shift with its own fit to all blocks."""
    place = np.full(rows[0].p, -1)
    place[active] = np.arange(len(active))
    m, total = len(active), sum(r.length for r in rows)
    blocks = [b for r in rows for s in stretches(r.time) for b in _blocks(r.part(s), place, weights, shifts, total)]
    G, h = sum(b[0] for b in blocks), sum(b[1] for b in blocks)
    scale = np.sqrt(np.maximum(np.diag(G), TINY))
    x = solve(G / scale[:, None] / scale, (h / scale[:, None]).T, np.zeros(m), RIDGE) / scale  # (K, m)
    return np.array([t - 2.0 * np.einsum("mk,km->k", h, x) + np.einsum("km,mq,kq->k", x, G, x) for G, h, t in blocks])


def _blocks(r: Rows, place: Integers, weights: Array, shifts: Array, total: int) -> list[tuple[Array, Array, Array]]:
    """Normal matrix (m, m), right sides (m, K) and squares (K,) of the torque in blocks of an even stretch."""
    m, K, made = int(place.max()) + 1, len(shifts), []
    # Samples that a shift would read from beyond the ends are left out for all shifts alike.
    step = usual_step(r.time) if r.length > 1 else 1.0
    margin = min(int(np.ceil(REACH / step)) + 1, r.length // 4)
    torque = np.stack([moved(r.torque, shift / step) for shift in shifts], axis=-1)  # (S, n, K)
    share = max(1, round(TIME_BLOCKS * r.length / total))
    for keep in np.array_split(np.arange(margin, r.length - margin), share):
        G, h, t = np.zeros((m, m)), np.zeros((m, K)), np.zeros(K)
        for j, (c, v) in enumerate(zip(r.columns, r.values, strict=True)):
            own = place[c] >= 0
            Y, at = v[own][:, keep], place[c[own]]
            G[np.ix_(at, at)] += weights[j] * Y @ Y.T
            h[at] += weights[j] * Y @ torque[keep, j]
            t += weights[j] * np.sum(torque[keep, j] ** 2, axis=0)
        made.append((G, h, t))
    return made


def _at(shifts: Array, loss: Array, near: int, shift: float) -> Array:
    """(B,) squared errors at a shift, by parabolas through those (B, K) of the shift `near` and its neighbours."""
    k = int(np.clip(near, 1, len(shifts) - 2))
    x = (shift - shifts[k]) / (shifts[1] - shifts[0])
    left, middle, right = loss[:, k - 1], loss[:, k], loss[:, k + 1]
    return np.asarray(middle + 0.5 * x * (right - left) + 0.5 * x**2 * (right - 2.0 * middle + left))


def _lowest(shifts: Array, loss: Array) -> float:
    """Where a parabola through the least value and its neighbours is lowest."""
    k = int(np.clip(np.argmin(loss), 1, len(loss) - 2))
    left, middle, right = loss[k - 1 : k + 2]
    bend = left - 2.0 * middle + right
    move = 0.5 * (left - right) / bend if bend > 0.0 else 0.0
    return float(shifts[k] + np.clip(move, -1.0, 1.0) * (shifts[1] - shifts[0]))
