# SPDX-License-Identifier: Apache-2.0
"""The parts of the study: the CHASI platform as its data sheet has it, its task, and the stand-in robot.

The functions are made for plans: `type = "trueup.studies.stanley.chasi:simulator"`, options as their parameters.
"""

from __future__ import annotations

from collections.abc import Sequence

from trueup.campaign.kinds import DRIVES
from trueup.controllers.stanley import GAINS, StanleySettings
from trueup.engines.vehicle import BETAS, BicycleSimulator, Vehicle, vehicle_space
from trueup.errors import unknown_name
from trueup.paths import Path
from trueup.paths.courses import COURSES
from trueup.robots.stand_in_vehicle import StandInVehicle
from trueup.tasks.follow_path import FollowPath

SETTINGS = StanleySettings()

CHASI = Vehicle(
    "chasi", wheelbase=0.55, max_steering=0.698,
    values={"speed_delay": 0.0, "steering_delay": 0.0, "acceleration_limit": 0.5, "yaw_rate_limit": 1.0,
            "yaw_acceleration_limit": 1.0},
)  # fmt: skip
"""With the defaults of the paper's Table II, as estimated from its Figure 4 (c): no delays."""

TUNED = (*GAINS, "lead")
"""The paper's three gains, and how far ahead in time the law looks, which makes up for the delays that it found."""

DURATION = 170.0
"""Of one run on the hairpin course, in s (the paper's t_a)."""


def simulator(parameters: tuple[str, ...] = DRIVES, position_noise: float = 0.006, heading_noise: float = 0.005,
              seed: int = 0, threads: int | None = None) -> BicycleSimulator:  # fmt: skip
    """The bicycle with `parameters` to calibrate; those of Table II alone start from its defaults."""
    noise = {"position_noise": position_noise, "heading_noise": heading_noise}
    values = {n: v for n, v in CHASI.values.items() if n in parameters} if set(parameters) <= {*BETAS, *noise} else {}
    vehicle = Vehicle(CHASI.name, CHASI.wheelbase, CHASI.max_steering, {**values, **noise})
    return BicycleSimulator(vehicle, vehicle_space(vehicle, parameters), seed=seed, threads=threads)


def task(
    paths: Sequence[str | Path] = ("hairpin",), gains: tuple[str, ...] = TUNED, measure: str = "rms"
) -> FollowPath:
    """Follow paths, or courses by name, with the gains to tune. Raises UnknownNameError for a course that is none."""
    alone = tuple(paths) == ("hairpin",)
    return FollowPath([course(p) if isinstance(p, str) else p for p in paths], SETTINGS, names=tuple(gains), measure=measure,
                      duration=DURATION if alone else None)  # fmt: skip


def course(name: str) -> Path:
    """A course by name. Raises UnknownNameError, which lists them."""
    if name not in COURSES:
        raise unknown_name("course", name, COURSES, "those that can be driven")
    return COURSES[name]()


def robot(number: int = 0, seed: int = 0, failing: float = 0.0) -> StandInVehicle:
    """Stand-in `number` of the series, with its hidden truth."""
    return StandInVehicle(number, SETTINGS, seed=seed, failing=failing)
