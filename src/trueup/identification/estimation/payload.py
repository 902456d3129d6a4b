# SPDX-License-Identifier: Apache-2.0
"""Torque constants for a drives description, from logs of currents with and without a payload that was weighed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trueup.errors import IdentificationError
from trueup.identification.estimation.drive_gains import drive_gains
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.identify import natural_cutoff
from trueup.identification.estimation.motion import log_of
from trueup.identification.estimation.pieces import pieces_of
from trueup.identification.estimation.pool import pool_for
from trueup.identification.estimation.quick import basic_columns
from trueup.identification.inertial import from_com
from trueup.identification.kinematic_tree import KinematicTree
from trueup.recording import Recording

Array = NDArray[np.float64]


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
