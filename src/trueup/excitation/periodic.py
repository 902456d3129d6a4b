# SPDX-License-Identifier: Apache-2.0
"""Joint motions that excite an arm: sums of sines within the papers' bounds, and Fourier series from rest to rest.

Each is a class of motion: genes (B, size) in [0, 1] make B motions, whatever search looks for the genes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from trueup.arrays import Array
from trueup.compiled import njit
from trueup.cores import in_threads
from trueup.errors import ModelError
from trueup.excitation.cell import Cell
from trueup.excitation.inverse_kinematics import REACHED
from trueup.excitation.limits import JointLimits
from trueup.excitation.trajectories import Motions, Trajectory
from trueup.rounding import ROUNDED, TINY


class MotionClass(Protocol):
    """What a search of excitations needs to know of a class of motions; `ViaPoints` of the planner is one too."""

    @property
    def size(self) -> int:
        """The number of genes."""
        ...

    def motions(self, genes: Array, samples: int, threads: int = 1) -> Motions:
        """The motions of genes (B, size) in [0, 1], each sampled evenly over its own duration."""
        ...


@dataclass(frozen=True, eq=False)
class Sines:
    """q = q0 + sum_k a_k sin(w_k t), |a_k| < q_max / W, |w_k| < sqrt(qdd_max / q_max), for 2 pi / min(w) seconds.

    Local identification, eq. 1 and its footnote; algorithm A. 2 W genes a joint. The bounds keep range and acceleration;
    `keep_speed` lowers those of w to qd_max / q_max where that is needed to keep the speed too.
    """

    limits: JointLimits
    terms: int = 5
    middle: Array | None = None
    """(n,) q0; None: the middle of the range."""
    reach: Array | None = None
    """(n,) q_max; None: half of the range, pi at most."""
    keep_speed: bool = True
    longest: float = 30.0
    """s; bounds w from below, since one slow term makes the whole long."""

    def __post_init__(self) -> None:
        """Raises ModelError where the bounds of w leave nothing."""
        slowest, fastest = self._rates
        if (fastest <= slowest).any():
            joint = self.limits.joints[int(np.argmin(fastest))]
            raise ModelError(
                f"joint '{joint}' may oscillate at {fastest.min():.3g} rad/s at most, which takes longer than "
                f"{self.longest:g} s; allow longer motions or a smaller reach"
            )

    @property
    def size(self) -> int:
        """The number of genes."""
        return 2 * self.terms * len(self.limits.joints)

    def motions(self, genes: Array, samples: int, threads: int = 1) -> Motions:
        """The motions of genes (B, size), each sampled evenly over its own duration; they begin at speed."""
        (slowest, fastest), (middle, reach) = self._rates, self._range
        both = genes.reshape(len(genes), 2, len(middle), self.terms)
        a = (2.0 * both[:, 0] - 1.0) * (reach / self.terms)[:, None]
        w = slowest + both[:, 1] * (fastest - slowest)[:, None]
        B, n = len(genes), len(middle)
        time = np.linspace(0.0, 1.0, samples) * (2.0 * np.pi / w.min(axis=(1, 2)))[:, None]
        q, qd, qdd = (np.empty((B, samples, n)) for _ in range(3))
        in_threads(lambda rows: _sines(middle, a[rows], w[rows], time[rows], q[rows], qd[rows], qdd[rows]), B, threads)
        return Motions(time, q, qd, qdd)

    @property
    def _range(self) -> tuple[Array, Array]:
        middle = self.limits.middle if self.middle is None else np.asarray(self.middle)
        return middle, self.limits.reach if self.reach is None else np.asarray(self.reach)

    @property
    def _rates(self) -> tuple[float, Array]:
        """The least w [rad/s] of all, and the largest (n,)."""
        _, reach = self._range
        fastest = np.sqrt(self.limits.acceleration / reach)
        return 2.0 * np.pi / self.longest, np.minimum(
            fastest, self.limits.speed / reach
        ) if self.keep_speed else fastest


@dataclass(frozen=True, eq=False)
class Fourier:
    """Fourier series of the joint speeds that start and end at rest, scaled to what the limits allow.

    q = q0 + sum_k a_k / (k w) sin(k w t) - b_k / (k w) cos(k w t) with sum a_k = 0 and sum k b_k = 0, so that speed and
    acceleration are zero at both ends (J. Swevers et al., "Optimal robot excitation and identification", IEEE T-RA
    13(5), 1997, for the series). 2 H + 2 genes a joint: coefficients, of which only the ratios count, the share of what
    the limits allow, and where in the range. Every gene gives a motion within range, speed and acceleration.
    """

    limits: JointLimits
    duration: float = 10.0
    """s of one period."""
    harmonics: int = 5
    least: float = 0.2
    """The share of what the limits allow at gene 0."""

    @classmethod
    def lasting(cls, limits: JointLimits, seconds: float) -> Fourier:
        """A period of so many s with harmonics of up to half a hertz, a few at least."""
        return cls(limits, seconds, int(np.clip(round(0.5 * seconds), 4, 10)))

    @property
    def size(self) -> int:
        """The number of genes."""
        return (2 * self.harmonics + 2) * len(self.limits.joints)

    def motions(self, genes: Array, samples: int, threads: int = 1) -> Motions:
        """The motions of genes (B, size), sampled evenly over one period, both ends included."""
        del threads  # matrix products
        B, n, H = len(genes), len(self.limits.joints), self.harmonics
        each = genes.reshape(B, n, 2 * H + 2)
        c = 2.0 * each[..., : 2 * H] - 1.0
        k = np.arange(1.0, H + 1.0)
        a = c[..., :H] - c[..., :H].mean(axis=-1, keepdims=True)
        b = c[..., H:] - (c[..., H:] @ k)[..., None] * k / (k @ k)
        c = np.concatenate([a, b], axis=-1)
        middle, half = self.limits.middle, self.limits.half
        aside = 2.0 * each[..., -1] - 1.0
        # The squares keep both the place and the room around it smooth, and within the range together.
        scale = self._scale(c, half * (1.0 - aside**2)) * (self.least + (1.0 - self.least) * each[..., -2])
        c = c * scale[..., None]
        q, qd, qdd = (np.ascontiguousarray(np.swapaxes(c @ basis.T, 1, 2)) for basis in self._bases(samples))
        q += (middle + half * aside * np.abs(aside))[:, None]
        return Motions(np.tile(np.linspace(0.0, self.duration, samples), (B, 1)), q, qd, qdd)

    def _scale(self, c: Array, room: Array) -> Array:
        """(B, n): what the limits allow of motions with coefficients c (B, n, 2 H) and `room` (B, n) about their means.

        A sum of high powers stands for the largest value: it is never below it, and smooth, so that slopes help a search.
        """
        power = 20
        used = np.zeros(c.shape[:2])
        allowed = (room, self.limits.speed, self.limits.acceleration)
        for basis, most in zip(self._bases(12 * self.harmonics), allowed, strict=True):
            share = (c @ basis.T) / np.broadcast_to(most, c.shape[:2])[..., None]
            used += ((share * share) ** (power // 2)).sum(axis=-1)
        return np.maximum(used, TINY) ** (-1.0 / power)

    def _bases(self, samples: int) -> tuple[Array, Array, Array]:
        """(samples, 2 H) what the coefficients are multiplied with for q (of mean zero), qd, qdd."""
        if samples not in self._known:
            w = 2.0 * np.pi / self.duration * np.arange(1.0, self.harmonics + 1.0)
            phase = np.linspace(0.0, self.duration, samples)[:, None] * w
            sine, cosine = np.sin(phase), np.cos(phase)
            self._known[samples] = (
                np.hstack([sine / w, -cosine / w]),
                np.hstack([cosine, sine]),
                np.hstack([-sine * w, cosine * w]),
            )
        return self._known[samples]

    @cached_property
    def _known(self) -> dict[int, tuple[Array, Array, Array]]:
        return {}


def joint_box(cell: Cell) -> tuple[Array, Array]:
    """(n,) middle and half width of the joint positions that place the tool in a region, for A_local.

    From the poses of the region that can be reached, without 5 % at both ends, since a box of joints always reaches further
    than the box of the tool. Raises ModelError where hardly any pose can be reached.
    """
    poses = 400
    genes = np.random.default_rng(0).uniform(size=(poses, cell.genes))
    positions, turns, own = cell.via_points(genes)
    found = []
    for p, R, x in zip(positions, turns, own, strict=True):
        q, ended = cell.kinematics.solve(R, p, cell.posture, x)
        if ended == REACHED:
            found.append(q)
    if len(found) < 0.1 * poses:
        raise ModelError(
            f"only {len(found)} of {poses} random poses of the region can be reached; make it smaller or move it"
        )
    low, high = np.quantile(found, [0.05, 0.95], axis=0)
    return 0.5 * (low + high), np.maximum(0.5 * (high - low), 1e-3)


def at_rest(trajectory: Trajectory, limits: JointLimits, rate: float | None = None) -> Trajectory:
    """The trajectory with a start from rest and a stop at rest added, by polynomials that meet its ends smoothly.

    Quintics in time lead to its first and from its last state, as long as speed and acceleration limits demand; they
    may leave the joint range by a little: check the result. `rate` in Hz (default: that of the trajectory).
    """
    step = 1.0 / rate if rate else float(trajectory.time[1] - trajectory.time[0])
    whole = trajectory
    for end, forward in ((0, False), (-1, True)):
        sign = 1.0 if forward else -1.0  # a start is a stop seen backwards in time
        state = (trajectory.q[end], sign * trajectory.qd[end], trajectory.qdd[end])
        if np.abs(state[1]).max() < ROUNDED and np.abs(state[2]).max() < ROUNDED:
            continue
        time, q, qd, qdd = _stop(*state, limits, step)
        if forward:
            whole = whole.then(Trajectory("stop", whole.joints, time, q, qd, qdd))
        else:
            start = Trajectory(whole.name, whole.joints, time, q[::-1], -qd[::-1], qdd[::-1])
            whole = start.then(whole)
    return whole


def _stop(q: Array, qd: Array, qdd: Array, limits: JointLimits, step: float) -> tuple[Array, Array, Array, Array]:
    """Time (s,) and q, qd, qdd (s, n) of the shortest stop that keeps the accelerations: speed falls by a cubic."""
    seconds = 0.2
    while True:
        count = int(np.ceil(seconds / step)) + 1
        T = step * (count - 1)
        x = np.linspace(0.0, 1.0, count)[:, None]
        # The cubic that fits speed and acceleration at the start, and zero for both at the end.
        bend = (qd * (-6 * x + 6 * x**2) + qdd * T * (1 - 4 * x + 3 * x**2)) / T
        if seconds > 30.0 or (np.abs(bend) <= np.maximum(limits.acceleration, np.abs(qdd))).all():
            break
        seconds *= 1.25
    speed = qd * (1 - 3 * x**2 + 2 * x**3) + qdd * T * (x - 2 * x**2 + x**3)
    way = qd * (x - x**3 + 0.5 * x**4) + qdd * T * (x**2 / 2 - 2 * x**3 / 3 + x**4 / 4)
    return step * np.arange(count, dtype=np.float64), q + T * way, speed, bend


@njit(cache=True, nogil=True)
def _sines(middle: Array, a: Array, w: Array, time: Array, q: Array, qd: Array, qdd: Array) -> None:
    """a, w (B, n, W), time (B, S) evenly from 0; q, qd, qdd (B, S, n). Phases are turned, not computed, at each step:
    of half a million, rounding leaves 1e-10 of an amplitude.
    """
    for b in range(len(a)):
        step = time[b, 1]
        for j in range(a.shape[1]):
            for s in range(time.shape[1]):
                q[b, s, j], qd[b, s, j], qdd[b, s, j] = middle[j], 0.0, 0.0
            for k in range(a.shape[2]):
                A, W = a[b, j, k], w[b, j, k]
                turn_c, turn_s = np.cos(W * step), np.sin(W * step)
                c, x = 1.0, 0.0
                for s in range(time.shape[1]):
                    q[b, s, j] += A * x
                    qd[b, s, j] += A * W * c
                    qdd[b, s, j] -= A * W * W * x
                    c, x = c * turn_c - x * turn_s, x * turn_c + c * turn_s
