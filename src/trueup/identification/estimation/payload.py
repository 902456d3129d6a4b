# SPDX-License-Identifier: Apache-2.0
"""What a unit of motor current is in torque, from runs with and without a payload that was weighed.

Currents alone tell a model only up to one factor for each drive. A known payload sets the scale: Gautier & Briot, "Global
identification of joint drive gains and dynamic parameters of robots", ASME J. Dyn. Sys. Meas. Control 136(5), 2014.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from trueup.arrays import Array, Integers
from trueup.errors import IdentificationError
from trueup.evidence import half_interval, jackknife, without_each
from trueup.identification.estimation.blocks import blocks_of, numbered
from trueup.identification.estimation.cutoff import natural_cutoff
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.estimate import crossed
from trueup.identification.estimation.moments import solve
from trueup.identification.estimation.motion import Piece, log_of, pieces_of
from trueup.identification.estimation.pool import Pool, pool_for, with_load_columns
from trueup.identification.estimation.quick import basic_columns
from trueup.identification.estimation.selection import TIME_BLOCKS
from trueup.identification.estimation.verdicts import SURE
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.rows import Rows
from trueup.recording import Recording
from trueup.rounding import TINY

_SPEED = ("quadratic", "root", "asymmetric")
"""Groups of friction that changes with speed otherwise than it sets in."""


@dataclass(frozen=True, eq=False)
class DriveGains:
    """Gains (n,) in N m (N) per unit of what was logged, their standard deviations, and the parameters (p,) beside them."""

    gains: Array
    deviations: Array
    """From leaving out one stretch of time after the other."""
    parameters: Array
    """Of the arm without the payload, in SI units."""
    payload: Array
    """(10,) of the payload: what was given, and what was found of the rest."""

    def poor(self) -> Integers:
        """Joints whose gain is uncertain by more than a tenth: the payload hardly loads them in these runs."""
        return np.flatnonzero(~(self.deviations < SURE * np.abs(self.gains)))


def drive_gains(
    free: Sequence[Rows], loaded: Sequence[Rows], payload: ArrayLike, columns: Sequence[int] | Integers
) -> DriveGains:
    """Gains g with g_j current_j = regressor row j @ parameters (+ what the payload adds), by two-stage least squares.

    `free`, `loaded`: runs without and with the payload, `torque` holding currents (S, n). `payload` (10,): its inertial
    parameters in the frame of the last link, NaN for those that nobody knows. `columns`: independent columns of the model.
    Raises IdentificationError where a run is missing, the payload weighs nothing, or no gain comes out above zero.
    """
    known = np.asarray(payload, dtype=float)
    if not free or not loaded:
        raise IdentificationError("drive gains need runs without the payload and runs with it; one of them is missing")
    if known.shape != (10,) or not known[0] > 0.0:
        raise IdentificationError(
            f"the payload needs 10 inertial parameters with a mass above 0 kg; got {known.tolist()}"
        )
    n, p, act = len(free[0].values), free[0].p, np.asarray(columns, dtype=np.int64)
    body = np.arange(10) + 10 * (n - 1)
    open_ = np.flatnonzero(np.isnan(known))
    wide = p + n + len(open_)
    rows = [
        *(_with_currents(r, None, body, open_) for r in free),
        *(_with_currents(r, known, body, open_) for r in loaded),
    ]
    active = np.concatenate([act, np.arange(p, wide)])
    blocks = blocks_of(rows, numbered(rows, TIME_BLOCKS), 0.0)
    left, right = crossed(blocks, _expected(blocks, np.setdiff1d(active, np.arange(p, p + n)), p), active)
    scale = np.sqrt(np.maximum(np.einsum("kjmm->m", np.abs(left)), TINY))
    left, right = left / scale[:, None] / scale, right / scale
    found, variance = np.zeros(wide), np.mean(np.concatenate([r.torque for r in (*free, *loaded)]) ** 2, axis=0)
    normal = right_side = np.zeros(0)
    for _ in range(4):  # joints weighed by what is left of their own currents
        normal, right_side = (np.tensordot(x, 1.0 / variance, (1, 0)) for x in (left, right))
        found[active] = solve(normal.sum(axis=0), right_side.sum(axis=0), np.zeros(len(active))) / scale
        errors = np.concatenate([r.torque - r.predict(found) for r in rows])
        variance = np.maximum(np.mean(errors**2, axis=0), TINY)
    without = solve(without_each(normal), without_each(right_side), np.zeros(len(active))) / scale
    gains, deviations = found[p : p + n], jackknife(without[:, len(act) : len(act) + n])
    _check_gains(gains)
    carried = known.copy()
    carried[open_] = found[p + n :]
    return DriveGains(gains, deviations, found[:p], carried)


def _check_gains(gains: Array) -> None:
    if not (gains > 0.0).all():
        joint = int(np.argmin(gains))
        raise IdentificationError(
            f"the gain of drive {joint + 1} comes out as {gains[joint]:.3g}, which no drive has: is its current logged with "
            "the other sign, or does the payload not load it in these runs? Stretch the arm out, move slowly and fast"
        )


def _with_currents(rows: Rows, payload: Array | None, body: Integers, open_: Integers) -> Rows:
    """Rows with a column for each gain, the current with its sign turned, one for each number of the payload that is not
    known, and the torque that the payload asks for.
    """
    n, columns, values, known = len(rows.values), [], [], np.zeros(rows.torque.shape)
    more = rows.p + n + np.arange(len(open_))
    for j, (c, v) in enumerate(zip(rows.columns, rows.values, strict=True)):
        held = np.zeros((10, rows.length))
        carried = np.isin(c, body)
        if payload is not None:
            held[c[carried] - body[0]] = v[carried]
            known[:, j] = -np.nan_to_num(payload) @ held
        columns.append(np.concatenate([c, [rows.p + j], more]))
        values.append(np.vstack([v, -rows.torque[:, j], held[open_]]))
    return Rows(tuple(columns), tuple(values), known, rows.time, rows.p + n + len(open_))


def _expected(blocks: Sequence[Rows], motion: Integers, p: int) -> list[Rows]:
    """The blocks with currents as motion and payload let expect them by all other blocks: instruments without their noise.

    Each current on all columns that no noise of a current is in, and on the torque of the payload: two-stage least squares,
    whose first stage leaves out what it predicts, so that it is not drawn to the noise where the payload is light (Angrist,
    Imbens & Krueger, "Jackknife instrumental variables estimation", J. Applied Econometrics 14(1), 1999). As a regressor the
    noisy current would draw its coefficient, a gain, to zero.
    """
    made = [[np.array(v) for v in r.values] for r in blocks]
    for j, columns in enumerate(blocks[0].columns):
        own, at = np.isin(columns, motion), int(np.flatnonzero(columns == p + j)[0])
        told = [np.vstack([r.values[j][own], r.torque[:, j]]) for r in blocks]
        size = np.sqrt(np.maximum(sum(np.sum(x**2, axis=1) for x in told), TINY))
        gram = np.array([x @ x.T for x in told]) / size[:, None] / size
        cross = np.array([x @ r.values[j][at] for x, r in zip(told, blocks, strict=True)]) / size
        weights = solve(without_each(gram), without_each(cross), np.zeros(len(size))) / size
        for v, x, w in zip(made, told, weights, strict=True):
            v[j][at] = w @ x
    return [replace(r, values=tuple(v)) for r, v in zip(blocks, made, strict=True)]


def payload_inertial(mass: float, com: Sequence[float] | None = None) -> Array:
    """(10,) the payload in the last link's frame: kg, m, kg m^2; NaN for what is not given.

    Raises IdentificationError for a mass that is not positive.
    """
    if not mass > 0.0:
        raise IdentificationError(f"a payload of {mass:g} kg cannot be: its mass must be above 0")
    if com is None:
        return np.concatenate([[mass], np.full(9, np.nan)])
    return np.concatenate([[mass], mass * np.asarray(com, dtype=float), np.full(6, np.nan)])


def drives_from_payload(
    tree: KinematicTree, unloaded: Sequence[Recording], loaded: Sequence[Recording], drives: Drives, payload: Array, *,
    cutoff: float | None = None,
) -> tuple[Drives, tuple[str, ...]]:  # fmt: skip
    """The drives with their torque constants found from runs with and without a payload at the last link, and notes.

    Constants that the payload does not show stay as given. Raises IdentificationError where it shows none.
    """
    logs, carrying = ([log_of(r, tree, drives) for r in group] for group in (unloaded, loaded))
    used = cutoff or natural_cutoff([*logs, *carrying])
    motions = [log.motion(used, measured_speed=False) for log in (*logs, *carrying)]
    pool = pool_for(tree, drives.coupling, motions, springs=drives.springs)
    pieces = [pieces_of(m, pool.model, used, 0.0)[0] for m in motions]
    rows, columns = _with_load(pool, pieces[: len(logs)], pieces[len(logs) :], payload)
    found = drive_gains(rows[: len(logs)], rows[len(logs) :], payload, columns)
    poor = found.poor()
    if len(poor) == tree.n:
        raise IdentificationError(
            "the run with the payload shows no torque constant to 10 %: carry more, and hold it far out in several poses"
        )
    sure = ~np.isin(np.arange(tree.n), poor)
    constants = np.where(sure, drives.constants * found.gains, drives.constants)
    shares = 100.0 * half_interval(TIME_BLOCKS) * found.deviations / np.abs(found.gains)
    shown = ", ".join(f"{tree.joints[k]} {constants[k]:.4g} +- {shares[k]:.2g} %" for k in np.flatnonzero(sure))
    notes = [f"torque constants from the payload, with 95 % intervals: {shown}"]
    if np.isnan(payload[1:4]).any():
        with_centre = np.where(np.arange(10) < 4, found.payload, payload)
        known = drive_gains(rows[: len(logs)], rows[len(logs) :], with_centre, columns)
        at = " ".join(f"{c:.3g}" for c in found.payload[1:4] / found.payload[0])
        wider = np.median(found.deviations / known.deviations)
        notes.append(
            f"the payload's centre of mass was not given and was found with them (about {at} m in the last link's frame, as "
            f"far as torque tells it): the intervals are {wider:.2g} times as wide as with it (--payload-com)"
        )
    if len(poor):
        unsure = ", ".join(tree.joints[k] for k in poor)
        notes.append(f"the payload does not show the torque constants of {unsure}; they stay as given")
    known = {*drives.known_constants, *(tree.joints[k] for k in np.flatnonzero(sure))}
    doubts = np.where(sure, found.deviations / np.abs(found.gains), 0.0)
    return replace(drives, constants=constants, known_constants=tuple(sorted(known)), doubts=doubts), tuple(notes)


def _with_load(
    pool: Pool, free: Sequence[Piece], loaded: Sequence[Piece], payload: Array
) -> tuple[list[Rows], Integers]:
    """Rows of all runs with friction that grows with the load, by bodies of a fit without it, and the columns to fit.

    It is larger where the payload is carried: without a column of its own it would pass for current. So would what friction
    does with speed and the basic model lacks (Stribeck): here all its forms count, as only the constants are kept.
    """
    basic = basic_columns(pool)
    rough = drive_gains([p.rows for p in free], [p.rows for p in loaded], payload, basic)
    links = pool.carried_links(rough.parameters)
    laden = np.vstack([links[:-1], links[-1] + rough.payload])
    pieces = (*with_load_columns(pool, free, links), *with_load_columns(pool, loaded, laden))
    friction = pool.columns("load", *pool.forms(), *_SPEED)
    return [p.rows for p in pieces], np.union1d(basic, friction)
