# SPDX-License-Identifier: Apache-2.0
"""The Stanley law compiled, for simulators that run it inside their own loop. The same law as `law.py`."""

from __future__ import annotations

import math

import numpy as np

from trueup.arrays import Array
from trueup.compiled import njit
from trueup.paths import Path

SEGMENT, ARC, RANGE, MEMORY = range(4)
"""What one copy remembers, and how many numbers that is: segment, arc length, speed range; all zero at the start."""


def path_table(path: Path) -> Array:
    """(N, 6) x, y, heading, curvature, speed, arc of a path, as the compiled law reads it."""
    columns = (*path.points.T, path.heading, path.curvature, path.speed, path.arc)
    return np.ascontiguousarray(np.stack(columns, axis=1))


@njit(cache=True, nogil=True, error_model="numpy")
def nearest(path: Array, x: float, y: float, ahead: float, memory: Array) -> tuple[int, float]:
    """Segment and arc length of the point of the path nearest to (x, y), from the last one onward.

    `memory` holds segment and arc length, and is moved on.
    """
    first = int(memory[SEGMENT])
    best, part, least = first, 0.0, 1e300
    for i in range(first, path.shape[0] - 1):
        if i > first and path[i, 5] >= memory[ARC] + ahead:
            break
        ax, ay = path[i, 0], path[i, 1]
        dx, dy = path[i + 1, 0] - ax, path[i + 1, 1] - ay
        t = ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy)
        t = min(max(t, 0.0), 1.0)
        ex, ey = x - ax - t * dx, y - ay - t * dy
        apart = ex * ex + ey * ey
        if apart < least:
            best, part, least = i, t, apart
    length = path[best + 1, 5] - path[best, 5]
    part = max(part, (memory[ARC] - path[best, 5]) / length)
    memory[SEGMENT] = best
    memory[ARC] = path[best, 5] + part * length
    return best, part


@njit(cache=True, nogil=True, error_model="numpy")
def stanley(
    gains: Array,
    settings: Array,
    path: Array,
    memory: Array,
    x: float,
    y: float,
    theta: float,
    speed: float,
    yaw_rate: float,
) -> tuple[float, float]:
    """Commanded speed (m/s) and steering (rad); `gains` (7,) and `settings` (7,) as in `law.py`."""
    gone, half = speed * gains[6], 0.5 * yaw_rate * gains[6]
    x, y, theta = x + gone * math.cos(theta + half), y + gone * math.sin(theta + half), theta + yaw_rate * gains[6]
    fx, fy = x + settings[0] * math.cos(theta), y + settings[0] * math.sin(theta)
    i, t = nearest(path, fx, fy, settings[6], memory)
    if memory[ARC] >= path[path.shape[0] - 1, 5] - 1e-3:
        return 0.0, 0.0
    heading = path[i, 2] + t * (path[i + 1, 2] - path[i, 2])
    dx = path[i, 0] + t * (path[i + 1, 0] - path[i, 0]) - fx
    dy = path[i, 1] + t * (path[i + 1, 1] - path[i, 1]) - fy
    left = -math.sin(heading) * dx + math.cos(heading) * dy
    turn = heading - theta
    turn -= 2.0 * math.pi * math.floor((turn + math.pi) / (2.0 * math.pi))
    up = (speed >= settings[3] + settings[5]) + (speed >= settings[4] + settings[5])
    down = (speed >= settings[3] - settings[5]) + (speed >= settings[4] - settings[5])
    memory[RANGE] = min(max(memory[RANGE], up), down)
    k = gains[int(memory[RANGE])]
    steering = gains[4] * turn + math.atan(k * left / (max(speed, 0.0) + gains[3]))
    curvature = path[i, 3] + t * (path[i + 1, 3] - path[i, 3])
    steering += gains[5] * (curvature * speed - yaw_rate)
    steering = min(max(steering, -settings[1]), settings[1])
    wanted = path[i, 4] + t * (path[i + 1, 4] - path[i, 4])
    return min(wanted, settings[2]), steering
