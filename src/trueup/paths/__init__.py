# SPDX-License-Identifier: Apache-2.0
"""Paths on the floor that a vehicle is to follow: dense points with heading, curvature and target speed."""

from trueup.paths.path import Path
from trueup.paths.speed import SpeedLimits

__all__ = ["Path", "SpeedLimits"]
