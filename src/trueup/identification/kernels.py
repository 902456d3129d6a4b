# SPDX-License-Identifier: Apache-2.0
"""Compiled inner loops of the joint-torque regressor, vectorised across samples.

Samples are worked on in blocks of `W`, each quantity a row of W numbers, so that every loop runs over samples at
constant distances in memory: the compiler turns it into vector instructions. Rows of a link are its angular velocity
(3), angular acceleration (3) and acceleration (3) in its own axes (`ROWS`), then for each joint 6: the angular velocity u and
the velocity w of the link's origin for a unit speed of that joint.
"""

from __future__ import annotations

import math

import numpy as np

from trueup.arrays import Array
from trueup.compiled import njit

W = 32
_OF_LINK = ("angular velocity", "angular acceleration", "acceleration")
ROWS = len(_OF_LINK) * len("xyz")
TILE = 4

# pi/2 in three parts, of which the first two have trailing zeros: k times them is exact for |k| < 2^20.
_PI1, _PI2, _PI3 = 1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21
_TAYLOR = tuple((-1.0) ** (k // 2) / math.factorial(k) for k in range(17))
"""Coefficients of sine (odd) and cosine (even)."""
_FUSED = {"contract"}  # a product and a sum may be one instruction; nothing else may be rearranged


@njit(cache=True, nogil=True, fastmath=_FUSED)
def sines(x: Array, sine: Array, cosine: Array) -> None:
    """Sine and cosine of a row (W,), to 1e-15 for |x| < 1e6: reduced by quarter turns, then Taylor series."""
    for s in range(W):
        k = np.floor(x[s] * (2.0 / np.pi) + 0.5)
        r = ((x[s] - k * _PI1) - k * _PI2) - k * _PI3
        z = r * r
        a = _TAYLOR[9] + z * (_TAYLOR[11] + z * (_TAYLOR[13] + z * _TAYLOR[15]))
        a = r + r * z * (_TAYLOR[3] + z * (_TAYLOR[5] + z * (_TAYLOR[7] + z * a)))
        b = _TAYLOR[10] + z * (_TAYLOR[12] + z * (_TAYLOR[14] + z * _TAYLOR[16]))
        b = 1.0 - 0.5 * z + z * z * (_TAYLOR[4] + z * (_TAYLOR[6] + z * (_TAYLOR[8] + z * b)))
        quarter = k - 4 * np.floor(k / 4)
        odd = (quarter == 1) | (quarter == 3)
        first, second = (b if odd else a), (a if odd else b)
        sine[s] = -first if quarter >= 2 else first
        cosine[s] = -second if (quarter == 1) | (quarter == 2) else second


@njit(cache=True, nogil=True, fastmath=_FUSED)
def pose(fixed: Array, slide: Array, x: Array, sine: Array, cosine: Array, T: Array) -> None:
    """Rows 0-8 of T: the rotation link to parent, `fixed` (3, 9) + sine, cosine; rows 9-11: the offset in the parent."""
    k, m, n, o, d = fixed[0], fixed[1], fixed[2], slide[0], slide[1]
    for s in range(W):
        si, co = sine[s], cosine[s]
        T[s] = k[0] + m[0] * si + n[0] * co
        T[W + s] = k[1] + m[1] * si + n[1] * co
        T[2 * W + s] = k[2] + m[2] * si + n[2] * co
        T[3 * W + s] = k[3] + m[3] * si + n[3] * co
        T[4 * W + s] = k[4] + m[4] * si + n[4] * co
        T[5 * W + s] = k[5] + m[5] * si + n[5] * co
        T[6 * W + s] = k[6] + m[6] * si + n[6] * co
        T[7 * W + s] = k[7] + m[7] * si + n[7] * co
        T[8 * W + s] = k[8] + m[8] * si + n[8] * co
        T[9 * W + s] = o[0] + d[0] * x[s]
        T[10 * W + s] = o[1] + d[1] * x[s]
        T[11 * W + s] = o[2] + d[2] * x[s]


@njit(cache=True, nogil=True, fastmath=_FUSED)
def motion(T: Array, up: Array, v: Array, acc: Array, axis: Array, turns: float, own: Array) -> None:
    """Rows 0-8 of a link from those of its parent `up`; `turns` is 1 for a revolute joint, 0 for a prismatic one."""
    x, y, z = axis[0], axis[1], axis[2]
    slides = 1.0 - turns
    for s in range(W):
        ox, oy, oz = up[s], up[W + s], up[2 * W + s]
        lx, ly, lz = up[3 * W + s], up[4 * W + s], up[5 * W + s]
        rx, ry, rz = T[9 * W + s], T[10 * W + s], T[11 * W + s]
        cx, cy, cz = oy * rz - oz * ry, oz * rx - ox * rz, ox * ry - oy * rx
        ax = up[6 * W + s] + ly * rz - lz * ry + oy * cz - oz * cy
        ay = up[7 * W + s] + lz * rx - lx * rz + oz * cx - ox * cz
        az = up[8 * W + s] + lx * ry - ly * rx + ox * cy - oy * cx
        R0, R1, R2 = T[s], T[W + s], T[2 * W + s]
        R3, R4, R5 = T[3 * W + s], T[4 * W + s], T[5 * W + s]
        R6, R7, R8 = T[6 * W + s], T[7 * W + s], T[8 * W + s]
        px, py, pz = R0 * ox + R3 * oy + R6 * oz, R1 * ox + R4 * oy + R7 * oz, R2 * ox + R5 * oy + R8 * oz
        speed, push = v[s], acc[s]
        gx, gy, gz = (py * z - pz * y) * speed, (pz * x - px * z) * speed, (px * y - py * x) * speed
        own[s] = px + turns * x * speed
        own[W + s] = py + turns * y * speed
        own[2 * W + s] = pz + turns * z * speed
        own[3 * W + s] = R0 * lx + R3 * ly + R6 * lz + turns * (x * push + gx)
        own[4 * W + s] = R1 * lx + R4 * ly + R7 * lz + turns * (y * push + gy)
        own[5 * W + s] = R2 * lx + R5 * ly + R8 * lz + turns * (z * push + gz)
        own[6 * W + s] = R0 * ax + R3 * ay + R6 * az + slides * (x * push + 2.0 * gx)
        own[7 * W + s] = R1 * ax + R4 * ay + R7 * az + slides * (y * push + 2.0 * gy)
        own[8 * W + s] = R2 * ax + R5 * ay + R8 * az + slides * (z * push + 2.0 * gz)


@njit(cache=True, nogil=True, fastmath=_FUSED)
def carried(T: Array, up: Array, own: Array) -> None:
    """The six rows u, w of a joint at a link, from those at the link's parent."""
    for s in range(W):
        ux, uy, uz = up[s], up[W + s], up[2 * W + s]
        rx, ry, rz = T[9 * W + s], T[10 * W + s], T[11 * W + s]
        wx = up[3 * W + s] + uy * rz - uz * ry
        wy = up[4 * W + s] + uz * rx - ux * rz
        wz = up[5 * W + s] + ux * ry - uy * rx
        R0, R1, R2 = T[s], T[W + s], T[2 * W + s]
        R3, R4, R5 = T[3 * W + s], T[4 * W + s], T[5 * W + s]
        R6, R7, R8 = T[6 * W + s], T[7 * W + s], T[8 * W + s]
        own[s] = R0 * ux + R3 * uy + R6 * uz
        own[W + s] = R1 * ux + R4 * uy + R7 * uz
        own[2 * W + s] = R2 * ux + R5 * uy + R8 * uz
        own[3 * W + s] = R0 * wx + R3 * wy + R6 * wz
        own[4 * W + s] = R1 * wx + R4 * wy + R7 * wz
        own[5 * W + s] = R2 * wx + R5 * wy + R8 * wz


@njit(cache=True, nogil=True, fastmath=_FUSED)
def power(m: Array, j: Array, y: Array) -> None:
    """Ten rows y: the coefficients of a link's parameters in its wrench's power for u, w; `m` its motion, `j` u and w."""
    for s in range(W):
        ox, oy, oz = m[s], m[W + s], m[2 * W + s]
        lx, ly, lz = m[3 * W + s], m[4 * W + s], m[5 * W + s]
        ax, ay, az = m[6 * W + s], m[7 * W + s], m[8 * W + s]
        ux, uy, uz = j[s], j[W + s], j[2 * W + s]
        wx, wy, wz = j[3 * W + s], j[4 * W + s], j[5 * W + s]
        along, square = wx * ox + wy * oy + wz * oz, ox * ox + oy * oy + oz * oz
        gx, gy, gz = uy * oz - uz * oy, uz * ox - ux * oz, ux * oy - uy * ox
        y[s] = wx * ax + wy * ay + wz * az
        y[W + s] = wy * lz - wz * ly + along * ox - square * wx + ay * uz - az * uy
        y[2 * W + s] = wz * lx - wx * lz + along * oy - square * wy + az * ux - ax * uz
        y[3 * W + s] = wx * ly - wy * lx + along * oz - square * wz + ax * uy - ay * ux
        y[4 * W + s] = ux * lx + gx * ox
        y[5 * W + s] = ux * ly + uy * lx + gx * oy + gy * ox
        y[6 * W + s] = uy * ly + gy * oy
        y[7 * W + s] = ux * lz + uz * lx + gx * oz + gz * ox
        y[8 * W + s] = uy * lz + uz * ly + gy * oz + gz * oy
        y[9 * W + s] = uz * lz + gz * oz
