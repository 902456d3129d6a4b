# SPDX-License-Identifier: Apache-2.0
"""A walk without a model of balance: shift to one leg, shorten the other, swing it, and lean against what gyros feel.

S. Behnke, "Online trajectory generation for omnidirectional biped walking", ICRA 2006, for phase, shift, shortening and
swing; F. Faber and S. Behnke, Humanoids 2007, for the closed loop; A. Farchy, S. Barrett, P. MacAlpine and P. Stone,
"Humanoid robots learning to walk faster", AAMAS 2013, table 1, for the 17 parameters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array
from trueup.controllers.controller import Observation
from trueup.controllers.walk_engine.attitude import Attitude, Complementary, Lean
from trueup.controllers.walk_engine.legs import Biped
from trueup.controllers.walk_engine.requests import OfTrial, Requests
from trueup.errors import ParameterError
from trueup.parameters import Parameter, ParameterSpace
from trueup.samples import wrapped

_SHORT = 0.125
"""Share of a straight leg by which a leg of extension -1 is shorter (Behnke: eta_min = 0.875)."""

PARAMETERS = ParameterSpace(
    (
        Parameter("stepPeriod", "s", 0.51, 0.34, 0.80, shown_by="time of two steps"),
        Parameter("amp_swing", "rad", 0.148, 0.05, 0.35, shown_by="how far the legs swing with a step of 100 %"),
        Parameter("knee", "1", 0.988, 0.2, 1.2, shown_by="how far the legs are bent all the time"),
        Parameter("startLength", "cycles", 2.58, 0.5, 4.0, shown_by="over how many cycles steps grow at the start"),
        Parameter("v_short", "1", 1.765, 1.3, 3.5, shown_by="a leg is lifted for 1 / v_short of a cycle"),
        Parameter("a_short", "1", 1.005, 0.15, 1.2, shown_by="how high it is lifted"),
        Parameter("phi_short", "rad", -0.585, -0.9, 0.6, shown_by="when it is lifted: later if lower"),
        Parameter("v_swing", "1", 1.364, 1.3, 3.5, shown_by="a leg swings for 1 / (2 v_swing) of a cycle"),
        Parameter("phi_swing", "rad", 0.002, -1.1, 0.6, shown_by="when it swings: later if lower"),
        Parameter("gyro_hipPitch", "1", 0.184, -0.3, 0.9),
        Parameter("gyro_kneePitch", "1", -0.347, -0.6, 0.6),
        Parameter("gyro_hipRoll", "1", 0.235, -0.3, 0.9),
        Parameter("gyro_ankleRoll", "1", -0.231, -0.3, 0.9),
        Parameter("scale_roll", "1", 1.83, 0.0, 3.0),
        Parameter("offset_pitch", "rad", -0.010, -0.15, 0.15),
        Parameter("scale_pitch", "1", 0.905, 0.0, 3.0),
        Parameter("fwdOffset", "m", -0.008, -0.03, 0.03, shown_by="drift while stepping on the spot"),
    )
)
"""The paper's parameters (its table 1), with values that walk a NAO at about 12 cm/s with steps of 67 %."""

_LEANING, _AGAINST = [1, 2, 3, 5], ("gyro_hipRoll", "gyro_hipPitch", "gyro_kneePitch", "gyro_ankleRoll")
"""Joints that lean against what gyros feel, and the parameters by which they do."""
_OF = 0.2029
"""m from hip to ankle of the NAO whose values they are."""


def sized(longest: float) -> ParameterSpace:
    """The same of a robot whose straight legs measure `longest` m from hip to ankle: lengths are in proportion to them, times
    of shorter ones to their root, as a pendulum's: such robots fall in less time. Longer legs walk in the NAO's own time.
    """
    size = longest / _OF
    by = {"m": size, "s": min(1.0, math.sqrt(size))}
    scaled = [(p, by.get(p.unit, 1.0)) for p in PARAMETERS.parameters]
    return ParameterSpace(
        tuple(replace(p, nominal=f * p.nominal, lower=f * p.lower, upper=f * p.upper) for p, f in scaled)
    )


def stepping_speed(values: Array, longest: float) -> Array:
    """(b,) m/s that full steps of walks with values (b, 17) make where feet do not slip: carrying legs swing back so fast."""
    p = dict(zip(PARAMETERS.names, np.atleast_2d(values).T, strict=True))
    length = longest * (1.0 - _SHORT * p["knee"])
    return 2.0 * np.sin(p["amp_swing"]) * length / (p["stepPeriod"] * (1.0 - 0.5 / p["v_swing"]))


@dataclass(frozen=True)
class Gait:
    """What of the walk is not tuned."""

    shift: float = 0.065
    """rad by which the legs lean to bring the body over one foot."""
    foot_roll: float = 0.48
    """Share of the shift by which the feet lean the other way."""
    shift_phase: float = 0.09
    """rad by which the shift is ahead of the phase."""
    lean: float = -0.043
    """rad by which the toes are up: the body leans forward."""
    rate: float = 0.02
    """s ahead that the lean is extrapolated with its rate."""
    sideways: float = 0.5
    """Sideways swing with a step of 100 %, as a share of `amp_swing`."""
    turning: float = 1.0
    """Turn of a leg with a step of 100 %, as a share of `amp_swing`."""
    stand: float = 0.5
    """s that it takes from the start pose to the stance, before the first step."""


class WalkEngine:
    """A Controller: b walks in lockstep with values (b, 17) of `PARAMETERS`.

    `requests` says where to go, and with which share of the largest step: by default what each trial says. A request is
    followed within a cycle, and steps grow from nothing over `startLength` cycles. Raises ParameterError for values of
    another shape.
    """

    def __init__(
        self, biped: Biped, values: Array, *, requests: Requests | None = None, period: float = 0.01,
        gait: Gait | None = None, attitude: Attitude | None = None,
    ) -> None:  # fmt: skip
        given = np.atleast_2d(np.asarray(values, dtype=np.float64))
        if given.shape[1:] != (len(PARAMETERS),):
            raise ParameterError(f"a walk has {len(PARAMETERS)} parameters, got values of shape {np.shape(values)}")
        self.period = period
        self._biped, self._gait = biped, gait or Gait()
        self._requests, self._attitude = requests or OfTrial(), attitude or Complementary()
        self._p = dict(zip(PARAMETERS.names, given.T[:, :, None], strict=True))  # name to (b, 1)
        gains = np.concatenate([self._p[gain] for gain in _AGAINST], axis=1)
        self._against = biped.legs.signs[:, _LEANING] * gains[:, None]  # (b, 2, 4)
        self._asked = np.zeros((len(given), 3))
        self._from = np.zeros((len(given), 2, 6))

    def reset(self, observation: Observation) -> None:
        """Begins at the pose that the legs are in."""
        self._asked = np.zeros_like(self._asked)
        self._from = np.array(observation.position[:, self._biped.places])
        self._attitude.reset(observation)

    def command(self, observation: Observation) -> Array:
        """(b, nu) joint angles in rad."""
        lean = self._attitude.update(observation, self.period)
        walked = observation.time - self._gait.stand
        period = self._p["stepPeriod"]
        if walked >= 0.0:
            wanted = np.clip(self._requests(observation), -1.0, 1.0)
            self._asked = self._asked + np.clip(wanted - self._asked, -self.period / period, self.period / period)
        cycles = max(walked, 0.0) / period
        angles = self._stepping(cycles)
        begun = min(max(observation.time / self._gait.stand, 0.0), 1.0)
        share = 0.5 - 0.5 * np.cos(np.pi * begun)
        angles = self._from + share * (angles - self._from)
        self._lean_against(angles, lean, share)
        return self._biped.commands(angles)

    def _stepping(self, cycles: Array) -> Array:
        """(b, 2, 6) joint angles after so many cycles (b, 1) of two steps, left leg before right."""
        p, gait, legs = self._p, self._gait, self._biped.legs
        grown = 0.5 - 0.5 * np.cos(np.pi * np.minimum(cycles / p["startLength"], 1.0))
        phase = 2.0 * np.pi * cycles - np.pi
        own = phase + np.array([np.pi, 0.0])  # of each leg: it is lifted about 0, the other one carries
        tilt = grown * gait.shift * np.cos(phase + gait.shift_phase)
        short = wrapped(own + p["phi_short"]) * p["v_short"]
        lifted = np.where(np.abs(short) < np.pi, 0.5 + 0.5 * np.cos(short), 0.0)
        length = legs.longest * (1.0 - _SHORT * (p["knee"] + grown * p["a_short"] * lifted))
        swing = grown * self._swing(own)
        forward, left, turn = (p["amp_swing"] * self._asked[:, k, None] for k in range(3))
        apart = np.array([1.0, -1.0]) * np.abs(gait.sideways * left)
        roll = -tilt + gait.sideways * left * swing + apart
        # The feet stay where `fwdOffset` says whatever the legs' length.
        pitch = forward * swing + np.arcsin(np.clip(p["fwdOffset"] / length, -1.0, 1.0))
        return legs.angles(
            legs.yawing(gait.turning * turn * swing), roll, pitch, length, np.repeat(gait.foot_roll * tilt, 2, axis=1),
            np.full(length.shape, gait.lean),
        )  # fmt: skip

    def _swing(self, own: Array) -> Array:
        """(b, 2) from -1, behind, to 1: a sine in the air, back at a constant speed."""
        v = self._p["v_swing"]
        x = wrapped(own + self._p["phi_swing"])
        half = 0.5 * np.pi / v
        back = 1.0 - (np.where(x < 0.0, x + 2.0 * np.pi, x) - half) / (np.pi - half)
        return np.where(np.abs(x) < half, np.sin(v * x), back)

    def _lean_against(self, angles: Array, lean: Lean, share: float) -> None:
        """Adds to hip, knee and ankle what the body's lean asks for."""
        p, ahead = self._p, self._gait.rate
        roll = share * p["scale_roll"] * (lean.roll + ahead * lean.roll_rate)[:, None]
        pitch = share * p["scale_pitch"] * ((lean.pitch + ahead * lean.pitch_rate)[:, None] - p["offset_pitch"])
        by = np.concatenate([roll, pitch, pitch, roll], axis=1)
        angles[:, :, _LEANING] += self._against * by[:, None]
