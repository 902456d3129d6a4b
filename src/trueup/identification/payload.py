# SPDX-License-Identifier: Apache-2.0
"""Torque constants of the drives from two runs, with and without a payload that is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.errors import IdentificationError
from trueup.identification.drives import Drives
from trueup.identification.identify import basic_columns, natural_cutoff, pieces_of
from trueup.identification.inertial import from_com
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.motion import log_of
from trueup.identification.pool import pool_for
from trueup.identification.torque_model import Rows
from trueup.recording import Recording

Array = NDArray[np.float64]

_SURE = 0.2
"""Relative standard deviation beyond which a constant is refused."""


@dataclass(frozen=True, eq=False)
class DriveGains:
    """Joint torque for a unit of what was logged: N m/A (N/A) behind the gears, and its standard deviation; (n,)."""

    gains: Array
    deviations: Array

    @property
    def certain(self) -> NDArray[np.bool_]:
        """(n,) whether the payload loaded the joint enough to tell."""
        return self.deviations < _SURE * np.abs(self.gains)


def payload_inertial(mass: float, com: Sequence[float], inertia: Array | None = None) -> Array:
    """(10,) the payload in the last link's frame: kg, m; a point mass unless `inertia` (3, 3) about its CoM is given.

    Raises IdentificationError for a mass that is not positive.
    """
    if not mass > 0.0:
        raise IdentificationError(f"a payload of {mass:g} kg cannot be: its mass must be above 0")
    return from_com(mass, np.asarray(com, dtype=float), np.zeros((3, 3)) if inertia is None else inertia)


def drive_gains(unloaded: Sequence[Rows], loaded: Sequence[Rows], payload: Array, link: int) -> DriveGains:
    """The constants from rows whose torque is the current as logged (A).

    Joint by joint the current is a linear function of the robot's own parameters, which both runs share, and of the
    payload's torque, which is known: its coefficient is the inverse of the constant. Noise is in the current alone, so
    nothing is biased. After Gautier & Briot, "Global identification of joint drive gains and dynamic parameters of
    robots", ASME J. Dyn. Syst. Meas. Control 136(5), 2014, with each joint by itself.
    """
    n = len(unloaded[0].values)
    slopes, deviations = np.zeros(n), np.zeros(n)
    for j in range(n):
        columns, current = [], []
        for r, carried in [*((r, False) for r in unloaded), *((r, True) for r in loaded)]:
            place = {int(k): i for i, k in enumerate(r.columns[j])}
            extra = np.zeros(r.length)
            for i, value in enumerate(payload if carried else ()):
                if (at := place.get(10 * link + i)) is not None:
                    extra = extra + value * r.values[j][at]
            columns.append(np.vstack([r.values[j], extra]))
            current.append(r.torque[:, j])
        A, y = np.concatenate(columns, axis=1), np.concatenate(current)
        size = np.maximum(np.linalg.norm(A, axis=1), 1e-300)
        gram = (A / size[:, None]) @ (A / size[:, None]).T
        inverse = np.linalg.pinv(gram, rcond=1e-10, hermitian=True)
        x = inverse @ ((A / size[:, None]) @ y)
        error = y - x @ (A / size[:, None])
        slopes[j] = x[-1] / size[-1]
        deviations[j] = np.sqrt(inverse[-1, -1] * np.mean(error**2)) / size[-1]
    safe = np.where(np.abs(slopes) > 0.0, slopes, np.nan)
    return DriveGains(1.0 / safe, np.abs(deviations / safe**2))


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
    pool = pool_for(tree, drives.coupling, motions, np.random.default_rng(0))
    basic = basic_columns(pool)
    model = pool.model.only([int(k) - 10 * tree.n for k in basic if k >= 10 * tree.n])
    rows = [pieces_of(m, model, used, 0.0)[0].rows for m in motions]
    found = drive_gains(rows[: len(logs)], rows[len(logs) :], payload, tree.n - 1)
    if not found.certain.any():
        raise IdentificationError(
            "the run with the payload shows no torque constant to 20 %: carry more, and hold it far out in several poses"
        )
    constants = np.where(found.certain, drives.constants * found.gains, drives.constants)
    shown = ", ".join(
        f"{joint} {c:.4g} +- {100 * d / abs(g):.1f} %"
        for joint, c, g, d, sure in zip(
            tree.joints, constants, found.gains, found.deviations, found.certain, strict=True
        )
        if sure
    )
    unsure = [joint for joint, sure in zip(tree.joints, found.certain, strict=True) if not sure]
    notes = [f"torque constants from the payload: {shown}"]
    if unsure:
        notes.append(f"the payload does not show the torque constants of {', '.join(unsure)}; they stay as given")
    return replace(drives, constants=constants), tuple(notes)
