# SPDX-License-Identifier: Apache-2.0
"""Headings from a gyroscope and the way of a receiver, of a vehicle that drives a known way."""

from __future__ import annotations

import numpy as np
import pytest

from trueup.recording import Channel
from trueup.tracking.heading import turned_with


@pytest.mark.parametrize(
    ("ahead", "left", "lasts"), [(0.0, 0.0, 2.0), (0.8, 0.3, 2.0), (-0.4, -0.2, 2.0), (0.8, 0.0, 10.0)]
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_heading_is_that_of_the_vehicle_wherever_on_it_the_antenna_is(
    ahead: float, left: float, lasts: float, sign: float
) -> None:  # fmt: skip
    # Curves to both sides at a few metres per second, 5 Hz fixes good to 15 mm, a gyroscope
    # whose zero is off.
    rng, dt = np.random.default_rng(5), 0.01
    time = np.arange(0.0, 120.0, dt)
    rate = np.repeat(rng.uniform(-0.8, 0.8, 60), round(lasts / dt))[: len(time)]
    speed = 2.0 + np.sin(0.3 * time)
    heading = np.cumsum(rate) * dt
    way = np.cumsum(speed * np.exp(1j * heading)) * dt + (ahead + 1j * left) * np.exp(1j * heading)
    fixes = way[::20] + 0.015 * (rng.normal(size=len(way[::20])) + 1j * rng.normal(size=len(way[::20])))
    position = Channel("position", ("x", "y"), "m", time[::20], np.column_stack([fixes.real, fixes.imag]))
    gyro = Channel("yaw_rate", ("yaw_rate",), "rad/s", time, sign * rate[:, None] + 0.002)
    found = turned_with(position, gyro, np.ones(len(position.time), dtype=bool))
    assert found is not None
    errors = np.angle(np.exp(1j * (found.values[:, 0] - heading[::20])))[50:]  # past ten seconds
    assert np.std(errors) < 0.012  # the antenna before the axle bent it by 0.06
