# SPDX-License-Identifier: Apache-2.0
"""Cars whose logs are written otherwise: other sizes, speeds, units and signs of commands, no heading, a slow receiver."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.recording import Channel, Recording
from trueup.simulators.car import Car
from trueup.simulators.car.car_file import read_car, write_car
from trueup.simulators.car.commands import with_commands
from trueup.simulators.car.driving import driven_by
from trueup.simulators.car.judging import Ahead
from trueup.simulators.car.rollout import CarSimulator
from trueup.simulators.car.tracking import cleaned

Array = NDArray[np.float64]


def winding(speed: float, wheelbase: float, angle: float, rate: float, noise: float, seed: int = 0) -> Recording:
    """A car at a steady speed on a winding way, steered in rad up to `angle`, its pose logged at `rate` Hz."""
    rng = np.random.default_rng(seed)
    fine = np.arange(0.0, 80.0, 0.01)
    steering = angle * np.sin(0.5 * fine)
    late = np.interp(fine - 0.12, fine, steering)
    heading = np.cumsum(speed * np.tan(late) / wheelbase * 0.01)
    way = np.cumsum(speed * 0.01 * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    kept = slice(None, None, round(100.0 / rate))
    time = fine[kept]
    command = np.stack([0.3 + 0.1 * np.sin(fine), steering], axis=1)[kept]
    points = way[kept] + rng.normal(0.0, noise, (len(time), 2))
    return Recording("winding", {
        "command": Channel("command", ("throttle", "steering"), "", time, command),
        "position": Channel("position", ("x", "y"), "m", time, points),
        "heading": Channel("heading", ("heading",), "rad", time, heading[kept, None]),
    })  # fmt: skip


def with_values(recording: Recording, name: str, values: Array) -> Recording:
    return recording.with_channel(recording.channel(name).replace(values=values))


@pytest.fixture(scope="module")
def full_size() -> Recording:
    return winding(20.0, 2.7, 0.05, 10.0, 0.03)


def test_a_full_size_cars_receiver_may_jump_now_and_then(full_size: Recording) -> None:
    rng = np.random.default_rng(1)
    points = np.array(full_size.channel("position").values)
    off = rng.choice(len(points), len(points) // 33, replace=False)
    points[off] += 8.0
    known = np.isfinite(cleaned(with_values(full_size, "position", points)).channel("position").values[:, 0])
    assert not known[off].any()
    assert known.sum() >= 0.99 * (len(points) - len(off))


def test_the_way_driven_stands_for_a_heading_and_never_looks_ahead(full_size: Recording) -> None:
    bare = full_size.without("heading")
    found, truth = cleaned(bare).channel("heading").values[:, 0], full_size.channel("heading").values[:, 0]
    assert np.abs((found - truth + np.pi) % (2 * np.pi) - np.pi)[20:].mean() < 0.03
    points = np.array(bare.channel("position").values)
    points[401:] = points[400] + 1.5 * (points[401:] - points[400])
    again = cleaned(with_values(bare, "position", points)).channel("heading").values[:, 0]
    assert again[:401] == pytest.approx(found[:401], abs=1e-9)


def test_a_quaternion_or_a_compass_gives_the_heading(full_size: Recording) -> None:
    truth = full_size.channel("heading")
    yaw, zero = truth.values[:, 0], np.zeros(len(truth.time))
    turned = Channel("orientation", ("qx", "qy", "qz", "qw"), "", truth.time,
                     np.stack([zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)], axis=1))  # fmt: skip
    compass = with_values(full_size, "heading", 0.5 * np.pi - truth.values)
    for given in (full_size.without("heading").with_channel(turned), compass):
        off = cleaned(given).channel("heading").values[:, 0] - yaw
        assert np.abs((off + np.pi) % (2 * np.pi) - np.pi).max() < 1e-6


def test_commands_in_degrees_pulses_or_to_the_right_count_as_shares() -> None:
    """Every way of writing the same commands gives the same shares up to a constant, and a left turn counts above zero."""
    plain = winding(1.2, 0.2, 0.3, 50.0, 0.001)
    throttle, steering = plain.channel("command").values.T
    written = {
        "degrees": ([0.0, 0.0], [1.0, 20.0], [throttle, np.degrees(steering)]),
        "pulses": ([1500.0, 1500.0], [500.0, -500.0], [1500 + 500 * throttle, 1500 - 900 * steering]),
        "speed": ([0.0, 0.0], [5.0, 1.0], [10 * throttle, steering]),
    }
    for name, (middle, full, values) in written.items():
        given = with_values(plain, "command", np.stack(values, axis=1))
        car, notes = with_commands(Car("car", 0.2), [given])
        assert list(car.middle) == middle, name
        assert car.full is not None
        assert list(car.full) == full, name
        assert notes
        shares = CarSimulator(car).prepared(given).channel("command").values
        assert np.corrcoef(shares[:, 1], steering)[0, 1] > 0.999
        assert np.abs(shares).max() <= 1.0
    assert with_commands(Car("car", 0.2), [plain]) == (Car("car", 0.2), ())


def test_a_car_file_says_what_its_commands_mean(tmp_path: Path) -> None:
    car = Car("car", 0.2, middle=(1500.0, 1500.0), full=(500.0, -500.0))
    write_car(car, tmp_path / "car.toml")
    assert read_car(tmp_path / "car.toml") == car


def test_a_fast_cars_metres_count_less_than_a_slow_ones(full_size: Recording) -> None:
    simulator = CarSimulator(Car("car", 2.7))
    slow = winding(1.2, 0.2, 0.3, 50.0, 0.001)
    unit = [float(Ahead(simulator, [cleaned(r)]).scale("position", ("x",))[0]) for r in (slow, full_size)]
    assert unit == pytest.approx([0.02, 0.02 * 20.0 / 1.5], rel=0.05)


def test_a_place_on_earth_is_metres_from_the_first_fix(full_size: Recording) -> None:
    """Against the length of a degree at 48 degrees north, from tables of the WGS 84: 111.2 km north, 74.6 km east."""
    way = full_size.channel("position").values
    degrees = np.radians(np.stack([48.0 + way[:, 1] / 111_200.0, 11.0 + way[:, 0] / 74_630.0], axis=1))
    position = full_size.channel("position").replace(labels=("latitude", "longitude"), unit="rad", values=degrees)
    found = cleaned(full_size.with_channel(position)).channel("position").values
    assert found - found[0] == pytest.approx(way - way[0], abs=2e-3 * np.ptp(way))


def test_without_a_pose_speed_and_turn_rate_add_up_to_one(full_size: Recording) -> None:
    heading = full_size.channel("heading")
    turning = np.gradient(heading.values[:, 0], heading.time)
    bare = full_size.without("position").without("heading")
    bare = bare.with_channel(Channel("yaw_rate", ("yaw_rate",), "rad/s", heading.time, turning[:, None]))
    bare = bare.with_channel(Channel("speed", ("speed",), "m/s", heading.time, np.full((len(heading.time), 1), 20.0)))
    run = cleaned(bare)
    way, truth = run.channel("position").values, full_size.channel("position").values
    length = np.linalg.norm(np.diff(truth, axis=0), axis=1).sum()
    turned = np.array([[np.cos(a), -np.sin(a)] for a in [heading.values[0, 0]]])
    assert np.linalg.norm(way[-1]) == pytest.approx(np.linalg.norm(truth[-1] - truth[0]), abs=0.01 * length)
    assert (turned[0] * way[5]).sum() == pytest.approx(truth[5, 0] - truth[0, 0], abs=0.3)
    assert "add up" in run.provenance["warnings"]


def test_pedals_topics_of_their_own_and_turn_rates_drive_a_car_too() -> None:
    plain = winding(1.2, 0.2, 0.3, 50.0, 0.001)
    command = plain.channel("command")
    throttle, steering = command.values.T
    zero = 0 * throttle
    brake = np.maximum(-np.sin(command.time), 0.0)
    pedals = command.replace(
        labels=("throttle", "steering", "brake"), values=np.stack([throttle, steering, brake], axis=1)
    )
    assert driven_by(plain.with_channel(pedals)).values == pytest.approx(np.stack([throttle - brake, steering], axis=1))
    apart = plain.without("command")
    apart = apart.with_channel(Channel("command_speed", ("speed",), "", command.time[::5], throttle[::5, None]))
    apart = apart.with_channel(Channel("command_steering", ("steering",), "", command.time, steering[:, None]))
    assert driven_by(apart).column("steering") == pytest.approx(steering)
    assert np.abs(driven_by(apart).column("throttle") - throttle).max() < 0.02
    turning = np.stack([zero + 1.2, 1.2 * np.tan(steering) / 0.2], axis=1)
    wheels = command.replace(labels=("speed", "turn"), values=turning)
    assert driven_by(plain.with_channel(wheels), 0.2).column("steering") == pytest.approx(steering)
