# SPDX-License-Identifier: Apache-2.0
"""What is hidden in the stand-in vehicle: tyres that slip, a steering with delay, lag, rate limit and slack, a noisy pose.

The last eight fields are structure that robots of the series do not have.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np

from trueup.arrays import Array

_SERIES = {
    "forward": (0.24, 0.31), "mass": (40.0, 60.0), "yaw_inertia": (3.0, 5.0), "front_stiffness": (600.0, 1400.0),
    "rear_stiffness": (800.0, 1600.0), "friction": (0.5, 0.8), "steering_delay": (0.08, 0.22),
    "steering_lag": (0.05, 0.15), "steering_rate": (0.8, 2.0), "steering_slack": (0.01, 0.05),
    "steering_scale": (0.88, 1.02), "steering_offset": (-0.03, 0.03), "speed_delay": (0.05, 0.25),
    "speed_lag": (0.08, 0.25), "acceleration": (0.5, 1.0), "wheel_scale": (0.92, 0.98), "latency": (0.02, 0.08),
    "position_noise": (0.003, 0.010), "heading_noise": (0.002, 0.008), "drift": (0.002, 0.010),
}  # fmt: skip
"""Between which ends the robots of the series differ, each in the unit of its field below; drawn in this order."""


@dataclass(frozen=True)
class VehicleTruth:
    """Sizes of the CHASI platform; delay and lag of the steering as measured on small real cars (0.14 to 0.20 s in all)."""

    wheelbase: float = 0.55
    """In m."""
    forward: float = 0.27
    """From the rear axle to the centre of mass, in m."""
    mass: float = 50.0
    """In kg."""
    yaw_inertia: float = 4.0
    """In kg m2."""
    front_stiffness: float = 900.0
    """Cornering stiffness of the front axle, in N/rad."""
    rear_stiffness: float = 1100.0
    """In N/rad."""
    friction: float = 0.7
    """Tyre forces end here, as a share of the load."""
    max_steering: float = 0.698
    """In rad."""
    steering_delay: float = 0.15
    """In s."""
    steering_lag: float = 0.10
    """In s."""
    steering_rate: float = 1.5
    """In rad/s."""
    steering_slack: float = 0.03
    """End to end, in rad."""
    steering_scale: float = 0.97
    """Angle reached / angle commanded."""
    steering_offset: float = 0.01
    """In rad."""
    speed_delay: float = 0.12
    """In s."""
    speed_lag: float = 0.15
    """In s."""
    acceleration: float = 0.7
    """Most that the drive can do, in m/s^2."""
    wheel_scale: float = 0.95
    """Speed over ground / speed of the wheels."""
    latency: float = 0.04
    """Age of the pose when it is used, in s."""
    position_noise: float = 0.006
    """In m."""
    heading_noise: float = 0.005
    """In rad."""
    drift: float = 0.006
    """Slow error of the localisation, standard deviation, in m."""
    asymmetry: float = 0.0
    """Share of the steering angle that is missing to the right."""
    slope: float = 0.0
    """Pull of a floor that falls towards -y, in m/s^2."""
    relaxation: float = 0.0
    """Way rolled until the tyres take up a new slip angle, in m."""
    compliance: float = 0.0
    """Steering angle that gives way under the front tyres, in rad/N."""
    steering_quantum: float = 0.0
    """Least step of the steering, in rad."""
    order_period: float = 0.0
    """Time between two orders that the drives take, in s; 0: every one."""
    pose_period: float = 0.0
    """Time between two poses of the localisation, each held until the next, in s; 0: one at every tick."""
    sag: float = 0.0
    """Share of the wheels' speed over ground that is lost in 100 s (a battery, a tyre that warms)."""

    @classmethod
    def of_seed(cls, seed: int) -> VehicleTruth:
        """A robot of the series: one of as many as there are seeds."""
        uniform = np.random.default_rng([seed, 20240711]).uniform
        return cls(**{name: uniform(*ends) for name, ends in _SERIES.items()})

    @property
    def row(self) -> Array:
        """(30,) all of it, in the order above, as the compiled truth reads it."""
        return np.array(astuple(self), dtype=np.float64)
