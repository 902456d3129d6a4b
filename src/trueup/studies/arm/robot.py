# SPDX-License-Identifier: Apache-2.0
"""The arm of both papers, a COMAU SMART NS16-1.65: lengths, limits, drives, a plausible set of links, regions.

Sources: [1] "On Robot Dynamic Model Identification through Sub-Workspace Evolved Trajectories for Optimal Torque
Estimation", [2] "Robot-Dynamic Calibration Improvement by Local Identification", [3] the URDF that the papers'
laboratory published (CNR-STIIMA-IRAS, comau-experimental). Links are an estimate: a fit of possible bodies to the base
parameters that [2], table III, prints for algorithm A, with priors on mass and size.
"""

from __future__ import annotations

import numpy as np

from trueup.excitation.limits import JointLimits
from trueup.excitation.regions import Region
from trueup.identification.inertial import from_com
from trueup.identification.kinematic_tree import KinematicTree, from_dh

JOINTS = tuple(f"axis{i}" for i in range(1, 7))
NOMINAL = np.array([546.0, 954.0, 486.0, 51.1, 55.3, 35.0])
"""N m at the joints: gear ratio times nominal motor torque, [1] table I."""
RATIOS = np.array([182.0, 159.0, 162.0, 73.0, 79.0, 50.0])
ROTORS = np.array([17.6, 53.0, 14.5, 1.30, 3.20, 1.70])
"""kg m^2 at the joints; estimate, as the links."""
COULOMB = np.array([41.0, 63.0, 44.0, 1.9, 2.6, 1.1])
VISCOUS = np.array([6.2, 8.4, 6.6, 0.19, 0.28, 0.07])
QUADRATIC = np.array([-2.0, -3.0, -3.0, 0.1, 0.1, 0.1])
"""Friction in N m, N m s/rad, N m s^2/rad^2: the magnitudes of [1], table II, region B, labels put in an order that fits
the size of the axes."""

_LINKS = (  # mass kg; centre of mass m; Ixx Iyy Izz Ixy Ixz Iyz about it, kg m^2; axes of DH frame i, origin i - 1
    (115.6, (0.106, -0.250, 0.0), (9.06, 6.60, 9.06, 0.0, 0.0, 0.0)),
    (66.3, (0.331, 0.020, 0.060), (3.04, 3.67, 6.63, -0.42, -0.01, -0.36)),
    (47.6, (0.126, -0.040, 0.083), (1.38, 2.11, 2.94, -0.03, 0.61, 0.01)),
    (17.9, (0.002, 0.227, -0.007), (0.463, 0.162, 0.617, -0.03, 0.02, -0.01)),
    (5.17, (0.0, -0.003, 0.088), (0.021, 0.019, 0.020, 0.0, 0.0, 0.0)),
    (2.29, (0.0, 0.0, 0.111), (0.009, 0.009, 0.018, 0.0, 0.0, 0.0)),
)
_LOWER = (-2.9, -0.873, -2.5, -3.1, -2.15, -3.1)  # [3]; axes 4-6 narrower than they could turn, for the cables
_UPPER = (2.9, 1.658, 1.9, 3.1, 2.15, 3.1)
_SPEED = np.radians([155.0, 155.0, 170.0, 360.0, 350.0, 550.0])  # the maker's brochure
_ACCELERATION = np.array([6.0, 5.0, 7.0, 15.0, 15.0, 20.0])  # estimate: top speed in about 0.4 s

REGIONS = {  # boxes of 0.3 m in one quadrant, +-30 degrees: [1] shows them without sizes
    "A": Region.of([0.85, 0.35, 0.45], 0.3),
    "B": Region.of([1.05, 0.25, 0.85], 0.3),
    "C": Region.of([0.70, 0.65, 0.70], 0.3),
}


def ns16() -> KinematicTree:
    """The arm standing on the floor; link frames are those in which [1], table II, groups its parameters."""
    half = np.pi / 2
    links = np.array([
        from_com(mass, np.array(com), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
        for mass, com, (xx, yy, zz, xy, xz, yz) in _LINKS
    ])  # fmt: skip
    return from_dh(
        [0.3, 0.7, 0.185, 0.0, 0.0, 0.0], [-half, 0.0, -half, half, -half, 0.0], [0.6, 0.0, 0.0, 0.624, 0.0, 0.135],
        [0.0, -half, 0.0, 0.0, 0.0, 0.0], joints=JOINTS, name="NS16", lower=_LOWER, upper=_UPPER, speed=_SPEED,
        effort=NOMINAL, inertial=links, armature=ROTORS,
    )  # fmt: skip


def limits() -> JointLimits:
    """Its joint limits; the torque is the nominal one."""
    return JointLimits(JOINTS, np.array(_LOWER), np.array(_UPPER), _SPEED, _ACCELERATION, NOMINAL)
