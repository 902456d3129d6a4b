# SPDX-License-Identifier: Apache-2.0
"""Inertial units are read in the unit that gravity and a turning base give them, and are left alone where nothing tells."""

from __future__ import annotations

import re

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.articulated.inertial import together, with_inertial_units
from trueup.articulated.pose import quaternion_of, turning, up_of
from trueup.recording import Channel, Recording
from trueup.units import to_si

_TIME = np.arange(0.0, 6.0, 0.01)
_DEGREES = 180.0 / np.pi


def _sways(acc: float = 1.0, gyro: float = 1.0, gravity: float = 9.81, angles: bool = False) -> Recording:
    """A base that sways, its accelerometer and gyro times these factors of SI, with noise, and its orientation."""
    rng, shape = np.random.default_rng(0), (len(_TIME), 3)
    phases, sizes = np.array([2.0, 3.1, 0.9]), np.array([0.1, 0.07, 0.2])
    turns, rates = sizes * np.sin(np.outer(_TIME, phases)), sizes * phases * np.cos(np.outer(_TIME, phases))
    steps = np.stack([np.sin(9.0 * _TIME), 2.0 * np.cos(9.0 * _TIME), np.sin(18.0 * _TIME)], axis=1)
    still = np.array([0.0, 0.0, gravity])
    channels = [
        Channel("acc", ("x", "y", "z"), "", _TIME, acc * (still + steps + rng.normal(0.0, 0.1, shape))),
        Channel("gyro", ("x", "y", "z"), "", _TIME, gyro * (turning(turns, rates) + rng.normal(0.02, 0.01, shape))),
        Channel("base_orientation", ("roll", "pitch", "yaw"), "rad", _TIME, turns) if angles else
        Channel("base_orientation", ("w", "x", "y", "z"), "", _TIME, quaternion_of(turns) + rng.normal(0.0, 5e-4, (600, 4))),
    ]  # fmt: skip
    return Recording("sways", {c.name: c for c in channels})


@pytest.mark.parametrize("angles", [False, True])
@pytest.mark.parametrize(("acc", "gyro"), [(1.0, 1.0), (1.0 / 9.80665, _DEGREES), (1000.0 / 9.80665, _DEGREES)])
def test_gravity_and_the_orientation_tell_the_units(acc: float, gyro: float, angles: bool) -> None:
    (found,), notes = with_inertial_units([_sways(acc, gyro, angles=angles)])
    plain = _sways()
    for name, unit in (("acc", "m/s^2"), ("gyro", "rad/s")):
        assert found.channel(name).unit == unit
        assert found.channel(name).values == pytest.approx(plain.channel(name).values, rel=1e-3, abs=1e-3)
    assert [note.split(":")[0] for note in notes] == ["acc", "gyro"]
    for note, name in zip(notes, ("acc", "gyro"), strict=True):  # what is advised is what a mapping takes
        unit, scale = re.findall('unit = "([^"]+)"(?:, scale = ([0-9.e-]+))?', note)[0]
        advised = float(scale or 1.0) * to_si(unit)[1] * _sways(acc, gyro, angles=angles).channel(name).values
        assert advised == pytest.approx(plain.channel(name).values, rel=1e-3, abs=1e-3)


def test_raw_counts_are_said_with_the_scale_that_gravity_gives_them() -> None:
    (found,), notes = with_inertial_units([_sways(16384.0 / 9.80665)])
    assert found.channel("acc").unit == ""
    assert "unit unknown; 16" in notes[0]
    assert 'unit = "m/s^2", scale = 0.00059' in notes[0]


def test_an_accelerometer_without_gravity_gets_no_unit() -> None:
    (found,), notes = with_inertial_units([_sways(gravity=0.0)])
    assert found.channel("acc").unit == ""
    assert "is it without gravity?" in notes[0]


def test_units_that_are_said_and_gyros_beside_nothing_stay() -> None:
    (found,), _ = with_inertial_units([_sways()])
    assert with_inertial_units([found]) == ([found], [])
    alone = _sways(gyro=_DEGREES).without("base_orientation").without("acc")
    assert with_inertial_units([alone]) == ([alone], [])
    fast = Recording("fast", {"gyro": alone.channel("gyro").replace(values=4.0 * alone.channel("gyro").values)})
    assert with_inertial_units([fast])[0][0].channel("gyro").unit == "rad/s"


def test_how_a_gyro_is_mounted_shows_in_what_it_turns() -> None:
    log = _sways()
    gyro, pose = log.channel("gyro"), log.channel("base_orientation")
    onto = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    found = together(gyro.replace(values=gyro.values @ onto.T), pose)
    assert found is not None
    assert found.axes == pytest.approx(onto, abs=0.05)
    assert found.fits > 0.95


@pytest.mark.parametrize(("size", "unit"), [(1.0, "rad/s"), (_DEGREES, "deg/s")])
def test_gravity_that_turns_tells_the_unit_of_a_gyro(size: float, unit: str) -> None:
    def seen(up: NDArray[np.float64]) -> tuple[Recording, list[str]]:
        sways, rng = _sways(gyro=size).without("base_orientation"), np.random.default_rng(1)
        pushes = 1.5 * rng.normal(size=(len(_TIME), 3))
        acc = sways.channel("acc").replace(values=9.81 * up + pushes)
        (found,), notes = with_inertial_units([sways.with_channel(acc)])
        return found, notes

    turns = np.array([0.1, 0.07, 0.2]) * np.sin(np.outer(_TIME, [2.0, 3.1, 0.9]))
    found, notes = seen(up_of(quaternion_of(turns)))
    assert found.channel("gyro").unit == "rad/s"
    assert found.channel("gyro").values == pytest.approx(_sways().channel("gyro").values, rel=1e-3, abs=1e-3)
    assert f"turns as it does in {unit}" in notes[1]
    found, _ = seen(np.tile([0.0, 0.0, 1.0], (len(_TIME), 1)))  # gravity that does not turn tells nothing
    assert found.channel("gyro").unit == ""
