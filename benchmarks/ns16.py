# SPDX-License-Identifier: Apache-2.0
"""The industrial arm of the two identification papers: kinematics, limits, nominal torques.

Lengths and twists: constants of Table II of "sub-workspace evolved trajectories" (a1 .3, a2 .7, a3 .185, d4 .624 m);
gear ratios and motor torques: its Table I; speeds and ranges: the maker's brochure; accelerations: estimates.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trueup.excitation.limits import JointLimits
from trueup.identification.kinematic_tree import KinematicTree, from_dh

Array = NDArray[np.float64]

_LOWER = (-3.142, -0.873, -2.967, -3.142, -2.147, -3.142)
_UPPER = (3.142, 1.658, 1.92, 3.142, 2.147, 3.142)
_SPEED = (155.0, 155.0, 170.0, 360.0, 350.0, 550.0)  # deg/s
_ACCELERATION = (6.0, 5.0, 7.0, 15.0, 15.0, 20.0)  # rad/s^2
NOMINAL = np.array([546.0, 954.0, 486.0, 51.1, 55.3, 35.0])
"""N m at the joints."""


def arm() -> tuple[KinematicTree, JointLimits]:
    """The tree and its limits."""
    half = 0.5 * np.pi
    tree = from_dh(
        [0.3, 0.7, 0.185, 0.0, 0.0, 0.0], [-half, 0.0, -half, half, -half, 0.0], [0.6, 0.0, 0.0, 0.624, 0.0, 0.135],
        [0.0, -half, 0.0, 0.0, 0.0, 0.0], lower=_LOWER, upper=_UPPER, speed=np.radians(_SPEED), effort=NOMINAL,
    )  # fmt: skip
    return tree, JointLimits.of(tree).changed(acceleration=dict(zip(tree.joints, _ACCELERATION, strict=True)))
