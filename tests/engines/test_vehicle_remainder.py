# SPDX-License-Identifier: Apache-2.0
"""Vehicles whose structure the simulator lacks are told of, whatever it is, and no others."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.calibration import Calibration, Estimate
from trueup.engines.vehicle import Vehicle, VehicleSimulator
from trueup.engines.vehicle.family import Vehicles
from trueup.engines.vehicle.remainder import errors_go_with
from trueup.engines.vehicle.vehicle import TURNED
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]
STEP, SECONDS = 0.02, 60.0
VALUES = {"speed_gain": 5.0, "turn_lag": 0.12, **dict.fromkeys(("speed_delay", "speed_lag", "turn_delay"), 0.0),
          "push_lasts": 0.0, "trim_lasts": 0.0}  # fmt: skip


def drive(
    seed: int, *, trailer: float = 0.0, skids: float = 0.0, slope: float = 0.0, sags: float = 0.0, hills: float = 0.0
) -> Recording:
    """A robot on two driven wheels; a trailer 0.6 m behind holds it back from turning, or it skids aside in its turns, or it
    drives on a floor that slopes or over hills (rad, 3 m from one to the next), or its battery gives less (share in the end).
    """
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, SECONDS, STEP)
    turns = (0.2, 1.0) if hills else (-1.0, 1.0)  # it comes by again where it has been
    knots = np.arange(0.0, SECONDS + 2.0, 2.0)
    told = np.stack([np.interp(time, knots, rng.uniform(*ends, len(knots))) for ends in ((0.3, 1.0), turns)], axis=1)
    x = y = psi = v = w = hinge = 0.0
    rows, fine = [], 10
    full = 1.0 + sags * (0.5 - time / SECONDS)
    for speed, turn in (told * full[:, None]).tolist():
        rows.append([x, y, psi])
        for step in [STEP / fine] * fine:
            v += step * VALUES["speed_gain"] * (speed - v) - step * 9.81 * slope * np.cos(psi - 0.7)
            v -= step * 9.81 * hills * (np.sin(2.0 * x) * np.cos(psi) + np.cos(2.0 * y) * np.sin(psi))
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
    ("cause", "aspect", "lacks"),
    [
        ("what was commanded", "heading", {"trailer": 0.4}),
        ("what was commanded", "across the vehicle", {"skids": 0.2}),
        ("how long the vehicle had driven", "heading", {"sags": 0.3}),
        ("which way the vehicle faced", "along the vehicle", {"slope": 0.05}),
        ("where the vehicle was", "along the vehicle", {"hills": 0.08}),
        ("", "", {}),
    ],
)
def test_errors_that_go_with_something_are_told_of(cause: str, aspect: str, lacks: dict[str, float]) -> None:
    robot = VehicleSimulator(Vehicle("robot", 0.4, drive=TURNED, values=VALUES))
    drives = [robot.prepared(drive(seed, **lacks)) for seed in (0, 1)]
    said, left = errors_go_with(robot, np.zeros(0), drives, 3.0)
    assert left == ()
    assert len(said) == bool(aspect)
    assert all(aspect in text and f"goes with {cause}" in text and "times what noise" in text for text in said)


@pytest.mark.parametrize("seconds", [2.0, 20.0])
def test_drives_too_short_to_leave_stretches_out_tell_nothing(seconds: float) -> None:
    robot = VehicleSimulator(Vehicle("robot", 0.4, drive=TURNED, values=VALUES))
    short = robot.prepared(drive(0, trailer=0.4).slice(0.0, seconds))
    said, left = errors_go_with(robot, np.zeros(0), [short], 3.0)
    assert said == ()
    assert len(left) == (seconds > 3.0)
    assert all("Too little was driven" in text and "times what noise" in text for text in left)


def test_no_value_is_claimed_to_be_the_vehicles_own_where_its_errors_go_with_something() -> None:
    robot = Vehicle("robot", 0.4, drive=TURNED, values=VALUES)
    space = robot.space(("turn_left",), {}, 1.0)
    estimates = tuple(
        Estimate(p.name, p.unit, p.nominal, v, 0.99 * v, 1.01 * v, p.lower, p.upper, not p.frozen,
                 "frozen" if p.frozen else "identified")
        for p, v in ((p, robot.quantity(p.name).absent if p.name not in VALUES else VALUES[p.name]) for p in space.parameters)
    )  # fmt: skip
    found = Calibration("robot", estimates, (), (), np.zeros((0, 0)))

    def fit(*_: object, **__: object) -> Calibration:
        return found

    for lacks, word in (({"trailer": 0.4}, "effective"), ({}, "identified")):
        drives = [drive(seed, **lacks) for seed in (0, 1)]
        said = Vehicles().calibrate(VehicleSimulator(robot, space), drives, [], fit)
        assert [e.verdict for e in said.estimates if e.fitted] == [word]
