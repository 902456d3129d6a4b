# SPDX-License-Identifier: Apache-2.0
"""What a unit of motor current is in torque, from runs with and without a payload that was weighed.

Currents alone tell a model only up to one factor for each drive. A known payload sets the scale: Gautier & Briot, "Global
identification of joint drive gains and dynamic parameters of robots", ASME J. Dyn. Sys. Meas. Control 136(5), 2014.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trueup.errors import IdentificationError
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.identify import natural_cutoff
from trueup.identification.estimation.moments import blocks_of, moments_of, solve, weighted_fit
from trueup.identification.estimation.motion import log_of, pieces_of
from trueup.identification.estimation.pool import pool_for
from trueup.identification.estimation.quick import basic_columns
from trueup.identification.estimation.selection import BLOCKS
from trueup.identification.inertial import from_com
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.rows import Rows
from trueup.recording import Recording

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_POOR = 0.2


@dataclass(frozen=True, eq=False)
class DriveGains:
    """Gains (n,) in N m (N) per unit of what was logged, their standard deviations, and the parameters (p,) beside them."""

    gains: Array
    deviations: Array
    """From leaving out one stretch of time after the other."""
    parameters: Array
    """Of the arm without the payload, in SI units."""

    def poor(self) -> NDArray[np.int64]:
        """Joints whose gain is uncertain by more than a fifth: the payload hardly loads them in these runs."""
        return np.flatnonzero(~(self.deviations < _POOR * np.abs(self.gains)))


def drive_gains(
    free: Sequence[Rows], loaded: Sequence[Rows], payload: ArrayLike, columns: Sequence[int] | Integers, *, link: int = -1
) -> DriveGains:  # fmt: skip
    """Gains g with g_j current_j = regressor row j @ parameters (+ what the payload adds), by weighted least squares.

    `free`, `loaded`: runs without and with the payload, `torque` holding currents (S, n). `payload` (10,): its inertial
    parameters in the frame of link number `link` (the last). `columns`: independent columns of the model. Raises
    IdentificationError where a run is missing, the payload weighs nothing, or no gain comes out above zero.
    """
    known = np.asarray(payload, dtype=float)
    if not free or not loaded:
        raise IdentificationError("drive gains need runs without the payload and runs with it; one of them is missing")
    if known.shape != (10,) or not known[0] > 0.0:
        raise IdentificationError(
            f"the payload needs 10 inertial parameters with a mass above 0 kg; got {known.tolist()}"
        )
    n, p, act = len(free[0].values), free[0].p, np.asarray(columns, dtype=np.int64)
    body = np.arange(10) + 10 * (link % n)
    rows = [*(_with_currents(r, None, body) for r in free), *(_with_currents(r, known, body) for r in loaded)]
    moments = moments_of(blocks_of(rows, BLOCKS, 0.0))
    active = np.append(act, p + np.arange(n))
    currents = np.concatenate([r.torque for r in (*free, *loaded)])
    scaled, variance = weighted_fit(moments, active, np.zeros(p + n), variance=np.mean(currents**2, axis=0))
    found = moments.parameters(scaled)
    gram, cross = moments.only(active).weighted(1.0 / variance)
    left = solve(gram.sum(axis=0) - gram, cross.sum(axis=0) - cross, np.zeros(len(active)))[:, len(act) :]
    K, gains = len(left), found[p:]
    deviations = np.sqrt((K - 1) / K * np.sum((left / moments.scale[p:] - gains) ** 2, axis=0))
    if not (gains > 0.0).all():
        joint = int(np.argmin(gains))
        raise IdentificationError(
            f"the gain of drive {joint + 1} comes out as {gains[joint]:.3g}, which no drive has: is its current logged with "
            "the other sign, or does the payload not load it in these runs? Stretch the arm out, move slowly and fast"
        )
    return DriveGains(gains, deviations, found[:p])


def _with_currents(rows: Rows, payload: Array | None, body: Integers) -> Rows:
    """Rows with a column for each gain, the current with its sign turned, and the torque that the payload asks for."""
    columns, values, known = [], [], np.zeros(rows.torque.shape)
    for j, (c, v) in enumerate(zip(rows.columns, rows.values, strict=True)):
        columns.append(np.append(c, rows.p + j))
        values.append(np.vstack([v, -rows.torque[:, j]]))
        carried = np.isin(c, body)
        if payload is not None:
            known[:, j] = -payload[c[carried] - body[0]] @ v[carried]
    return Rows(tuple(columns), tuple(values), known, rows.time, rows.p + len(columns))


def payload_inertial(mass: float, com: Sequence[float], inertia: Array | None = None) -> Array:
    """(10,) the payload in the last link's frame: kg, m; a point mass unless `inertia` (3, 3) about its CoM is given.

    Raises IdentificationError for a mass that is not positive.
    """
    if not mass > 0.0:
        raise IdentificationError(f"a payload of {mass:g} kg cannot be: its mass must be above 0")
    return from_com(mass, np.asarray(com, dtype=float), np.zeros((3, 3)) if inertia is None else inertia)


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
    pool = pool_for(tree, drives.coupling, motions)
    rows = [pieces_of(m, pool.model, used, 0.0)[0].rows for m in motions]
    found = drive_gains(rows[: len(logs)], rows[len(logs) :], payload, basic_columns(pool))
    poor = found.poor()
    if len(poor) == tree.n:
        raise IdentificationError(
            "the run with the payload shows no torque constant to 20 %: carry more, and hold it far out in several poses"
        )
    sure = ~np.isin(np.arange(tree.n), poor)
    constants = np.where(sure, drives.constants * found.gains, drives.constants)
    shares = 100.0 * found.deviations / np.abs(found.gains)
    shown = ", ".join(f"{tree.joints[k]} {constants[k]:.4g} +- {shares[k]:.1f} %" for k in np.flatnonzero(sure))
    notes = [f"torque constants from the payload: {shown}"]
    if len(poor):
        unsure = ", ".join(tree.joints[k] for k in poor)
        notes.append(f"the payload does not show the torque constants of {unsure}; they stay as given")
    known = {*drives.known_constants, *(tree.joints[k] for k in np.flatnonzero(sure))}
    return replace(drives, constants=constants, known_constants=tuple(sorted(known))), tuple(notes)
