# SPDX-License-Identifier: Apache-2.0
"""What the columns of an inertial unit are along."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.formats.rules.bases import ANGLES, PLACES, QUATERNION, TURNS, order
from trueup.formats.rules.names import EULER, listed
from trueup.formats.rules.rule import Column
from trueup.samples import is_unit

INERTIAL = listed("imu gyro gyroscope gyr accel accelerometer acc omega")
"""Words for what an inertial unit measures."""
_ALONG = INERTIAL | listed("ang angular lin linear gravity")
"""And for what else is along three axes."""


def sensor_labels(group: Sequence[Column]) -> tuple[str, ...]:
    """Labels of what an inertial unit measures, in a list or in columns that are numbered: x, y, z of three numbers, or roll,
    pitch, yaw, and w, x, y, z of a quaternion; () for anything else.
    """
    plain, width = {word for c in group for word in c.parts.words}, sum(c.width for c in group)
    if not plain & (_ALONG | TURNS) or (len(group) > 1 and not all(_numbered(c) for c in group)):
        return ()
    if width == len(PLACES):
        return ANGLES if plain & EULER else PLACES if plain & _ALONG else ()
    values = np.hstack([c.values if c.values.ndim > 1 else c.values[:, None] for c in group])
    return tuple(order(group)) if width == len(QUATERNION) and is_unit(values) else ()


def _numbered(column: Column) -> bool:
    return column.width == 1 and (column.parts.bare or [""])[-1].isdigit()
