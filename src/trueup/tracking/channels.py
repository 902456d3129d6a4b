# SPDX-License-Identifier: Apache-2.0
"""What is measured of a vehicle, and the order in which its numbers stand wherever they stand beside one another."""

from __future__ import annotations

CHANNELS = {"position": ("x", "y"), "heading": ("heading",), "speed": ("speed",), "yaw_rate": ("yaw_rate",)}
"""Pose of the tracked point in m and rad, speed of the wheels in m/s, turn rate in rad/s."""
PLACE = {label: column for column, label in enumerate(label for labels in CHANNELS.values() for label in labels)}
"""Label to its column."""
READ = len(PLACE)
"""How many there are."""
