# SPDX-License-Identifier: Apache-2.0
"""What may be calibrated around the robot: the slope that it stands on, the floor, and what contacts are like."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.articulated.model import WORLD, Writable
from trueup.articulated.quantities.quantity import Quantity, around, factor


@dataclass(frozen=True, kw_only=True)
class Tilt(Quantity):
    """Gravity turned about x, then y: the base stands on a slope that the model does not know."""

    def write(self, copies: Writable, target: str, values: Mapping[str, Array]) -> None:
        """See Quantity."""
        roll, pitch = (np.asarray(values.get(f"tilt_{a}", 0.0), dtype=np.float64) for a in ("roll", "pitch"))
        if not np.any(roll) and not np.any(pitch):
            return
        x, y, z = copies.get("world.gravity", WORLD).T
        y, z = np.cos(roll) * y - np.sin(roll) * z, np.sin(roll) * y + np.cos(roll) * z
        x, z = np.cos(pitch) * x + np.sin(pitch) * z, -np.sin(pitch) * x + np.cos(pitch) * z
        copies.set("world.gravity", WORLD, np.stack([x, y, z], axis=-1))


@dataclass(frozen=True, kw_only=True)
class FloorTilt(Quantity):
    """The floor turned about the world's x, then y."""

    def write(self, copies: Writable, target: str, values: Mapping[str, Array]) -> None:
        """See Quantity."""
        level = np.zeros(len(next(iter(values.values()))))
        tilt = [values.get(f"floor_{a}", level) for a in ("roll", "pitch")]
        copies.set("world.floor_tilt", WORLD, np.stack(tilt, axis=-1))


WORLDS = (
    *(
        Tilt(name=f"tilt_{a}", family="world", unit="rad", title=f"gravity turned about {axis}", bounds=around(0.2),
             attributes=("world.gravity",), group="tilt")
        for a, axis in (("roll", "x"), ("pitch", "y"))
    ),
    Quantity(
        name="floor_height", family="world", unit="m", title="height of the floor", bounds=around(0.05),
        attributes=("world.floor_height",), start=None, needs="floor", shown_by="touching the floor in several places",
    ),
    *(
        FloorTilt(name=f"floor_{a}", family="world", unit="rad", title=f"floor turned about {axis}", bounds=around(0.2),
                  attributes=("world.floor_tilt",), group="floor_tilt", needs="floor",
                  shown_by="touching the floor in several places")
        for a, axis in (("roll", "x"), ("pitch", "y"))
    ),
    Quantity(
        name="floor_friction", family="world", unit="", title="sliding friction of the floor", scale="log",
        bounds=factor(30, 5, 0.3), attributes=("world.floor_friction",), start=None, needs="floor",
        shown_by="sliding along the floor",
    ),
    Quantity(
        name="contact_friction", family="geom", unit="", title="sliding friction", scale="log", bounds=factor(10, 5, 0.3),
        attributes=("geom.friction",), start=None, needs="shapes", shown_by="sliding contacts",
    ),
    Quantity(
        name="contact_softness", family="geom", unit="s", title="time constant of the contact", scale="log",
        bounds=factor(5, 10, 0.01), attributes=("geom.softness",), start=None, needs="shapes",
        shown_by="landings and impacts",
    ),
)  # fmt: skip
