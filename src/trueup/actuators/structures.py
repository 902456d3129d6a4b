# SPDX-License-Identifier: Apache-2.0
"""What a servo's law may consist of: its parameters with bounds, and the structures that are asked about in turn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.actuators.bench import Run
from trueup.actuators.servo import Law
from trueup.parameters import Parameter
from trueup.rounding import NEGLIGIBLE, ROUNDED

BASE = ("stiffness", "armature", "back_emf", "coulomb")
"""What every servo has: the balancing paper's eq. 2 and the rotor. A file in MJCF can hold them."""


@dataclass(frozen=True)
class Structure:
    """Something that a servo may have beyond BASE."""

    name: str
    parameters: tuple[str, ...]
    """Its law's, or its bench's; the first is tried at several sizes."""
    source: str
    """Where it comes from."""
    requires: str = ""
    """A structure that it refines."""


LIMIT, FORCE, LOAD = "voltage limit", "force limit", "friction under load"
PUNCH, VISCOUS, RATIO, ASKEW = "punch", "viscous friction", "damping ratio", "load askew"
DELAY, QUADRATIC, ZERO = "delay", "quadratic friction", "zero error"
LIMITS = (LIMIT, "supply sag", FORCE)
STRUCTURES = (
    Structure(LOAD, ("load_motor", "load_external"), "Duclusaud et al. 2025, M5"),
    Structure(ASKEW, ("hangs_at",), "horn mounted askew: where the load hangs is no zero of the sensor"),
    Structure("Stribeck friction", ("static", "stribeck_speed"), "Armstrong-Helouvry et al. 1994"),
    Structure("load sticks", ("load_static", "stribeck_speed"), "Duclusaud et al. 2025, M4", LOAD),
    Structure(VISCOUS, ("viscous",), "beside back-EMF, which acts while the motor is on"),
    Structure(QUADRATIC, ("quadratic",), "fast gears in grease"),
    Structure(LIMIT, ("full_error",), "full duty: DC motor at its supply"),
    Structure("supply sag", ("sag",), "resistance of supply and wires", LIMIT),
    Structure(FORCE, ("force_limit",), "current limit of the firmware"),
    Structure(DELAY, ("delay",), "bus and firmware"),
    Structure("dead band", ("dead_band",), "compliance margin; play before the sensor"),
    Structure(PUNCH, ("punch",), "least power of the firmware; steep onset of torque"),
    Structure("derivative gain", ("derivative",), "PD firmware"),
    Structure(RATIO, ("rate_gain",), "firmware whose damping follows the root of its gain"),
    Structure("integral gain", ("integral",), "PI firmware"),
    Structure(ZERO, ("zero",), "goals cut to whole counts; a position that another sensor measures"),
    Structure("profile speed", ("speed_limit",), "profile velocity of the firmware"),
    Structure("profile acceleration", ("acceleration_limit",), "profile acceleration of the firmware"),
)
BY_NAME = {s.name: s for s in STRUCTURES}
USUAL = (LOAD, ASKEW, "Stribeck friction", "load sticks", VISCOUS, LIMIT, DELAY, RATIO, "profile speed")
"""What most servos have: fewer at once, which a search finds more surely where no others are needed."""


@dataclass(frozen=True)
class Scales:
    """Sizes of what was recorded, from which bounds are made."""

    torque: float
    """N m that the load asked for."""
    error: float
    """rad, command minus position."""
    speed: float
    """rad/s."""
    acceleration: float
    """rad/s2."""
    inertia: float
    """kg m2."""
    most: float
    """rad, the largest error times the servo's setting."""
    hangs_at: float
    """rad, where the load is said to hang."""

    @classmethod
    def of(cls, runs: Sequence[Run]) -> Scales:
        """From measured motion; speed and acceleration by differences over 40 ms, their 95 % quantiles."""
        dt, torques, asked, speeds, rates, most = 0.02, [], [], [], [], 0.0
        for run in runs:
            grid = np.arange(0.0, run.time[-1], dt)
            q = np.interp(grid, run.time, run.position)
            told = run.command[run.given(grid)]
            v = (q[2:] - q[:-2]) / (2.0 * dt)
            a = (q[2:] - 2.0 * q[1:-1] + q[:-2]) / dt**2
            torques.append(run.bench.about_axis * a + run.bench.moment * np.sin(q[1:-1] - run.bench.hangs_at))
            asked.append(told - q)
            most = max(most, run.gain * float(np.max(np.abs(told - q))))
            speeds.append(v)
            rates.append(a)
        top = (float(np.quantile(np.abs(np.concatenate(x)), 0.95)) for x in (torques, asked, speeds, rates))
        torque, error, speed, rate = (max(x, ROUNDED) for x in top)
        return cls(torque, error, speed, rate, max(r.bench.about_axis for r in runs), most,
                   runs[0].bench.hangs_at)  # fmt: skip


def declared(scales: Scales) -> dict[str, Parameter]:
    """All parameters of law and bench, with generous bounds; `full_error` in place of the voltage limit."""
    t, e, v, a, i = scales.torque, scales.error, scales.speed, scales.acceleration, max(scales.inertia, NEGLIGIBLE)
    rows = (
        # name, unit, nominal, lower, upper, log
        ("stiffness", "N m/rad", 2.0 * t / e, 0.02 * t / e, 200.0 * t / e, 1),
        ("armature", "kg m2", 0.1 * i, 1e-4 * i, 30.0 * i, 1),
        ("back_emf", "N m s/rad", 0.1 * t / v, 1e-4 * t / v, 30.0 * t / v, 1),
        ("coulomb", "N m", 0.05 * t, 1e-4 * t, 2.0 * t, 1),
        ("viscous", "N m s/rad", 1e-2 * t / v, 1e-4 * t / v, 10.0 * t / v, 1),
        ("quadratic", "N m s2/rad2", 0.05 * t / v**2, 0.0, 3.0 * t / v**2, 0),
        ("static", "N m", 0.05 * t, 0.0, t, 0),
        ("stribeck_speed", "rad/s", 0.05, 2e-3, max(v, 0.2), 1),
        ("load_motor", "", 0.1, 0.0, 0.95, 0),
        ("load_external", "", 0.1, 0.0, 0.95, 0),
        ("load_static", "", 0.1, 0.0, 3.0, 0),
        # the error at which the firmware gives all it can: logs show that, whatever torque it is
        ("full_error", "rad", 0.7 * scales.most, 0.05 * scales.most, 4.0 * scales.most, 1),
        ("force_limit", "N m", t, 0.1 * t, 10.0 * t, 1),
        ("sag", "", 0.1, 0.0, 3.0, 0),
        ("dead_band", "rad", 0.02 * e, 0.0, e, 0),
        ("punch", "N m", 0.05 * t, 0.0, t, 0),
        ("derivative", "N m s/rad", 0.05 * t / v, 1e-4 * t / v, 10.0 * t / v, 1),
        ("rate_gain", "N m s/rad", 0.1 * t / v, 1e-4 * t / v, 30.0 * t / v, 1),
        ("integral", "N m/(rad s)", 0.5 * t / e, 1e-2 * t / e, 100.0 * t / e, 1),
        ("zero", "rad", 0.0, -0.2, 0.2, 0),
        ("hangs_at", "rad", scales.hangs_at, scales.hangs_at - 0.5, scales.hangs_at + 0.5, 0),
        ("delay", "s", 0.005, 0.0, 0.1, 0),
        ("speed_limit", "rad/s", v, 0.2 * v, 20.0 * v, 1),
        ("acceleration_limit", "rad/s2", a, 0.1 * a, 100.0 * a, 1),
    )  # fmt: skip
    return {n: Parameter(n, u, x, lo, hi, "log" if log else "linear") for n, u, x, lo, hi, log in rows}


def law_of(values: Mapping[str, float]) -> Law:
    """The law with these numbers, of which those of the bench are no part."""
    given = {n: x for n, x in values.items() if n != "hangs_at"}
    if "full_error" in given:
        given["voltage_limit"] = given.pop("full_error") * given["stiffness"]
    return Law(**given)
