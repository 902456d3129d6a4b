# SPDX-License-Identifier: Apache-2.0
"""Vehicles whose structure the simulator lacks are told of, whatever it is, and no others."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.engines.vehicle import Vehicle, VehicleSimulator
from trueup.engines.vehicle.remainder import unlike_commanded
from trueup.engines.vehicle.vehicle import TURNED
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]
STEP, SECONDS = 0.02, 60.0
VALUES = {"speed_gain": 5.0, "turn_lag": 0.12, **dict.fromkeys(("speed_delay", "speed_lag", "turn_delay"), 0.0),
          "push_lasts": 0.0, "trim_lasts": 0.0}  # fmt: skip


def drive(seed: int, *, trailer: float = 0.0, skids: float = 0.0) -> Recording:
    """A robot on two driven wheels; a trailer 0.6 m behind holds it back from turning, or it skids aside in its turns."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, SECONDS, STEP)
    knots = np.arange(0.0, SECONDS + 2.0, 2.0)
    told = np.stack(
        [np.interp(time, knots, rng.uniform(*ends, len(knots))) for ends in ((0.3, 1.0), (-1.0, 1.0))], axis=1
    )
    x = y = psi = v = w = hinge = 0.0
    rows, fine = [], 10
    for speed, turn in told.tolist():
        rows.append([x, y, psi])
        for step in [STEP / fine] * fine:
            v += step * VALUES["speed_gain"] * (speed - v)
            w += step / VALUES["turn_lag"] * (turn - w)
            turned = w - trailer * v * np.sin(hinge)
            hinge += step * (turned - v / 0.6 * np.sin(hinge))
            x += step * (v * np.cos(psi) + skids * turned * v * np.sin(psi))
            y += step * (v * np.sin(psi) - skids * turned * v * np.cos(psi))
            psi += step * turned
    pose = np.array(rows) + rng.normal(0.0, 1.0, (len(time), 3)) * [2e-3, 2e-3, 3e-3]
    channels = (
        Channel("command", ("speed", "turn"), "", time, told, ("m/s", "rad/s")),
        Channel("position", ("x", "y"), "m", time, pose[:, :2]),
        Channel("heading", ("heading",), "rad", time, pose[:, 2:]),
    )
    return Recording(f"drive {seed}", {c.name: c for c in channels})


@pytest.mark.parametrize(
    ("aspect", "trailer", "skids"), [("heading", 0.4, 0.0), ("across the vehicle", 0.0, 0.2), ("", 0.0, 0.0)]
)
def test_errors_that_go_with_the_commands_are_told_of(aspect: str, trailer: float, skids: float) -> None:
    robot = VehicleSimulator(Vehicle("robot", 0.4, drive=TURNED, values=VALUES))
    drives = [robot.prepared(drive(seed, trailer=trailer, skids=skids)) for seed in (0, 1)]
    said = unlike_commanded(robot, np.zeros(0), drives, 3.0)
    assert len(said) == bool(aspect)
    assert all(aspect in text and "goes with what was commanded" in text for text in said)


@pytest.mark.parametrize("seconds", [2.0, 20.0])
def test_drives_too_short_to_leave_stretches_out_tell_nothing(seconds: float) -> None:
    robot = VehicleSimulator(Vehicle("robot", 0.4, drive=TURNED, values=VALUES))
    short = robot.prepared(drive(0, trailer=0.4).slice(0.0, seconds))
    assert unlike_commanded(robot, np.zeros(0), [short], 3.0) == ()
