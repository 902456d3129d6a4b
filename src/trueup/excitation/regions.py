# SPDX-License-Identifier: Apache-2.0
"""The part of the workspace in which an arm may move its tool: a box for the tool, a cone for its orientation.

As a file (SI units, base frame of the model):

    link = "wrist_3_link"            # default: the last link
    tool = [0.0, 0.0, 0.15]          # the tool's centre on that link; default: its origin
    [box]
    centre = [0.8, 0.0, 0.6]
    size = [0.3, 0.3, 0.3]
    [orientation]                    # default: about the tool's axis in the posture, 30 deg
    centre = [0.0, 1.0, 0.0, 0.0]    # quaternion w x y z; [0, 1, 0, 0] points the tool's z axis down
    cone = 0.52                      # how far the tool's z axis may lean, rad
    spin = 0.52                      # how far the tool may turn about its z axis, rad; both ways
    [posture]                        # the branch of the inverse kinematics; default: the least singular one found
    elbow = -1.5
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trueup import files
from trueup.arrays import Array, Mask
from trueup.errors import ModelError
from trueup.identification.kinematic_tree import exponential, of_quaternion
from trueup.typed_toml import build, check_finite

Three = tuple[float, float, float]


@dataclass(frozen=True)
class _Box:
    centre: Three | None = None
    size: Three | None = None
    lower: Three | None = None
    upper: Three | None = None


@dataclass(frozen=True)
class _Orientation:
    centre: tuple[float, float, float, float] | None = None
    cone: float = math.radians(30.0)
    spin: float = cone


@dataclass(frozen=True)
class _RegionFile:
    box: _Box
    link: str | None = None
    tool: Three = (0.0, 0.0, 0.0)
    orientation: _Orientation = field(default_factory=_Orientation)
    posture: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Region:
    """A box (3,) in m about `centre` (3,) in the base frame, with orientations about `orientation` (3, 3)."""

    centre: Array
    size: Array
    orientation: Array | None = None
    """Rotation (3, 3) tool to base in the middle of the cone; None: that of the posture."""
    cone: float = _Orientation.cone
    spin: float = _Orientation.spin
    link: str | None = None
    tool: Array = field(default_factory=lambda: np.zeros(3))
    posture: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, centre: ArrayLike, size: ArrayLike, **rest: Any) -> Region:
        """A region from plain lists. Raises ModelError where the box has no volume."""
        box = np.broadcast_to(np.asarray(size, dtype=np.float64), (3,)).copy()
        middle = np.asarray(centre, dtype=np.float64)
        if middle.shape != (3,) or not np.isfinite(middle).all() or not (box > 0).all():
            raise ModelError(
                f"a region needs a centre of three numbers [m] and a size above 0; got {centre} and {size}"
            )
        return cls(middle, box, **rest)

    @classmethod
    def load(cls, path: str | Path) -> Region:
        """Reads a region file (see the module). Raises ModelError and UnknownNameError that name file and key."""
        file = Path(path)
        table = files.toml(file, ModelError)
        check_finite(table, str(file), ModelError)
        given = build(_RegionFile, table, str(file), ModelError)
        box, turn = given.box, given.orientation
        if box.lower is not None and box.upper is not None:
            lower, upper = np.array(box.lower), np.array(box.upper)
            centre, size = 0.5 * (lower + upper), upper - lower
        elif box.centre is not None and box.size is not None:
            centre, size = np.array(box.centre), np.array(box.size)
        else:
            raise ModelError(f"{file}, [box]: it needs centre and size, or lower and upper, in m")
        middle = None if turn.centre is None else _rotation(np.array(turn.centre), file)
        return cls.of(
            centre, size, link=given.link, tool=np.array(given.tool), orientation=middle, cone=turn.cone, spin=turn.spin,
            posture=given.posture,
        )  # fmt: skip

    def positions(self, genes: Array) -> Array:
        """(..., 3) tool positions [m] of genes (..., 3) in [0, 1]."""
        return self.centre + (genes - 0.5) * self.size

    def orientations(self, genes: Array, middle: Array) -> Array:
        """(..., 3, 3) tool orientations of genes (..., 3) in [0, 1] about `middle` (3, 3): two lean the axis, one spins.

        The square of the first two is folded onto the disc, so that no gene has an edge where another means nothing.
        """
        u, v = 2.0 * genes[..., 0] - 1.0, 2.0 * genes[..., 1] - 1.0
        lean_x, lean_y = u * np.sqrt(1.0 - 0.5 * v**2), v * np.sqrt(1.0 - 0.5 * u**2)
        nought = np.zeros_like(u)
        lean = exponential(self.cone * np.stack([lean_x, lean_y, nought], axis=-1))
        spin = exponential(np.stack([nought, nought, self.spin * (2.0 * genes[..., 2] - 1.0)], axis=-1))
        return middle @ lean @ spin

    def holds(self, positions: Array, margin: float = 0.0) -> Mask:
        """(...,) whether tool positions (..., 3) lie in the box, `margin` m around it included."""
        return np.all(np.abs(positions - self.centre) <= 0.5 * self.size + margin, axis=-1)


def _rotation(quaternion: Array, file: Path) -> Array:
    length = float(np.linalg.norm(quaternion))
    if not 0.5 < length < 2.0:
        raise ModelError(
            f"orientation centre in '{file}' is {quaternion.tolist()}; a unit quaternion w x y z is expected"
        )
    return of_quaternion(quaternion)
