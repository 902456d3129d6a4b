# SPDX-License-Identifier: Apache-2.0
"""Whether a heading is a compass's, in drives that stand, back off, go straight or say otherwise than their siblings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trueup.arrays import Array
from trueup.engines.vehicle import VehicleSimulator
from trueup.loop.prepare import Preparation, prepare
from trueup.recording import Channel, Recording
from trueup.tracking.cleaned import cleaned

NOISE, STEP = 0.03, 0.1
"""Of a good receiver, in m; s between its fixes."""


def _driven(name: str, speed: Array, turn: Array, begin: float = 0.0, seed: int = 0) -> Recording:
    """A car of these speeds in m/s and turn rates in rad/s, whose heading is the yaw, from `begin` on."""
    rng, time = np.random.default_rng(seed), STEP * np.arange(len(speed), dtype=np.float64)
    yaw = begin + np.cumsum(STEP * turn)
    way = np.cumsum(STEP * speed[:, None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=1), axis=0)
    channels = (
        Channel("command", ("throttle", "steering"), "", time, np.stack([0.1 * speed, turn], axis=1)),
        Channel("position", ("x", "y"), "m", time, way + rng.normal(0.0, NOISE, way.shape)),
        Channel("heading", ("heading",), "rad", time, yaw + rng.normal(0.0, 3e-3, yaw.shape)),
    )
    return Recording(name, {c.name: c for c in channels})


def _compass(drive: Recording) -> Recording:
    """The same with a heading from north, growing to the right."""
    heading = drive.channel("heading")
    return drive.with_channel(heading.replace(values=0.5 * np.pi - heading.values))


def _winding(name: str, seconds: float = 60.0, begin: float = 0.0) -> Recording:
    time = np.arange(0.0, seconds, STEP)
    return _driven(name, 5.0 + np.sin(0.3 * time), 0.3 * np.sin(0.5 * time), begin)


def _standing(name: str, seconds: float = 30.0) -> Recording:
    return _driven(name, np.zeros(round(seconds / STEP)), np.zeros(round(seconds / STEP)), 1.0)


def _off(found: Recording, drive: Recording) -> float:
    """How far the heading is from the yaw at most, in rad."""
    off = found.channel("heading").values - drive.channel("heading").values
    return float(np.abs((off + np.pi) % (2.0 * np.pi) - np.pi).max())


def _prepared(folder: Path, drives: list[Recording], held_out: list[Recording] | None = None) -> Preparation:
    (folder / "car.toml").write_text('[vehicle]\nwheelbase = 2.7\ndrive = "throttle"\n')
    return prepare(folder / "car.toml", drives, held_out or [])


def _read(ready: Preparation, drive: Recording) -> Recording:
    assert isinstance(ready.simulator, VehicleSimulator)
    return ready.simulator.prepared(drive)


def test_a_car_that_stands_before_it_drives_has_the_heading_of_the_drive() -> None:
    """The noise of a standing receiver is no motion: two thirds of this log would go anywhere."""
    rest, time = np.zeros(1200), np.arange(0.0, 60.0, STEP)
    speed, turn = np.append(rest, 5.0 + np.sin(0.3 * time)), np.append(rest, 0.1 * np.sin(0.2 * time))
    drive = _driven("late", speed, turn, 2.0)
    for given in (drive, _compass(drive)):
        found = cleaned(given, backs=False)
        assert _off(found, drive) < 1e-6
        assert "backwards" not in found.provenance.get("warnings", "")


@pytest.mark.parametrize("back", [0.25, 0.5])
def test_a_robot_that_backs_off_and_drives_on_may_have_a_compass(back: float) -> None:
    time = np.arange(0.0, 80.0, STEP)
    speed = np.where(time % 20.0 < 20.0 * back, -1.0, 1.2)
    drive = _driven("to and fro", speed, 0.5 * np.sin(0.37 * time))
    for given in (drive, _compass(drive)):
        assert _off(cleaned(given), drive) < 1e-6


def test_a_drive_that_tells_nothing_is_read_as_its_siblings_are(tmp_path: Path) -> None:
    drives = [_winding("a"), _winding("b", begin=2.0)]
    still = _standing("still")
    ready = _prepared(tmp_path, [_compass(d) for d in drives], [_compass(still)])
    for drive in (*drives, still):
        assert _off(_read(ready, _compass(drive)), drive) < 1e-6
    alone = ready.with_recordings([_compass(still)])
    assert _off(_read(alone, _compass(still)), still) < 1e-6
    assert _off(cleaned(_compass(still)), _compass(still)) < 1e-6  # as recorded


def test_straight_drives_tell_a_compass_together(tmp_path: Path) -> None:
    """Each alone goes as well with a yaw that counts from elsewhere."""
    straight = [
        _driven(f"to {begin:g}", np.full(200, 5.0), np.zeros(200), begin, k) for k, begin in enumerate((0.3, 1.4, 2.9))
    ]
    ready = _prepared(tmp_path, [_compass(d) for d in straight])
    assert max(_off(_read(ready, _compass(d)), d) for d in straight) < 1e-6


def test_a_drive_that_contradicts_its_siblings_is_read_as_they_are_and_said_to(tmp_path: Path) -> None:
    drives, other = [_winding("a"), _winding("b", begin=2.0)], _winding("other", begin=1.0, seconds=30.0)
    ready = _prepared(tmp_path, [*(_compass(d) for d in drives), other])
    assert "by the way driven here" not in _read(ready, _compass(drives[0])).provenance["warnings"]
    found = _read(ready, other)
    assert "grows to the left by the way driven here, to the right by that of all" in found.provenance["warnings"]
    turned = np.diff(found.channel("heading").values[:, 0]) + np.diff(other.channel("heading").values[:, 0])
    assert np.nanmax(np.abs(turned)) < 1e-6


def test_drives_whose_heading_comes_from_elsewhere_are_asked_apart(tmp_path: Path) -> None:
    drives, other = [_winding("a"), _winding("b", begin=2.0)], _winding("other", begin=1.0, seconds=30.0)
    yaw = other.channel("heading")
    half = 0.5 * yaw.values
    turned = Channel("orientation", ("qz", "qw"), "", yaw.time, np.hstack([np.sin(half), np.cos(half)]))
    apart = other.without("heading").with_channel(turned)
    ready = _prepared(tmp_path, [*(_compass(d) for d in drives), apart])
    assert _off(_read(ready, apart), other) < 1e-6
    assert "warnings" not in _read(ready, apart).provenance


def test_gyroscopes_that_begin_at_zero_keep_each_drives_own_zero(tmp_path: Path) -> None:
    drives = [_winding("a", begin=0.9), _winding("b", begin=2.2), _winding("c", begin=-2.0)]
    begun = [
        d.with_channel(h.replace(values=-(h.values - b)))
        for d, b in zip(drives, (0.9, 2.2, -2.0), strict=True)
        for h in [d.channel("heading")]
    ]
    ready = _prepared(tmp_path, begun)
    assert max(_off(_read(ready, g), d) for g, d in zip(begun, drives, strict=True)) < 0.02


@pytest.mark.parametrize("seed", range(4))
def test_a_parked_car_whose_receiver_drifts_keeps_its_heading(seed: int) -> None:
    rng, parked = np.random.default_rng(seed), _standing("parked", 60.0)
    drift = np.cumsum(rng.normal(0.0, 0.05, (600, 2)), axis=0)
    place = parked.channel("position")
    given = parked.with_channel(place.replace(values=place.values + drift))
    assert _off(cleaned(given), parked) < 1e-6


def _skidding(seed: int) -> Recording:
    """A robot whose wheels turn it half as far as they believe: its yaw and turn rate are those of its wheels."""
    rng, count = np.random.default_rng(seed), 900
    turn = np.repeat(rng.uniform(-0.5, 0.5, count // 30), 30)
    drive = _driven("skidding", np.full(count, 0.8), turn)
    time = drive.channel("heading").time
    believed = np.cumsum(STEP * 1.6 * turn)[:, None]
    rate = Channel("yaw_rate", ("yaw_rate",), "rad/s", time, 1.6 * turn[:, None])
    return drive.with_channel(drive.channel("heading").replace(values=believed)).with_channel(rate)


def test_a_heading_of_wheels_that_skid_is_not_used_beside_a_place_of_satellites() -> None:
    drive = _skidding(3)
    found = cleaned(drive)
    yaw = drive.channel("heading").values / 1.6
    off = np.abs((found.channel("heading").values - yaw + np.pi) % (2.0 * np.pi) - np.pi)[100:]
    assert np.sqrt(np.mean(off**2)) < 0.05  # of the wheels' heading 1.1
    assert "in neither sense and from no zero" in found.provenance["warnings"]


def test_a_tracker_before_the_axle_of_a_robot_that_turns_on_the_spot_contradicts_no_heading() -> None:
    time = np.arange(0.0, 90.0, STEP)
    drive = _driven("spins", 0.1 * np.sin(0.2 * time), 0.8 * np.sin(0.5 * time))
    yaw = drive.channel("heading").values
    ahead = 0.6 * np.concatenate([np.cos(yaw), np.sin(yaw)], axis=1)
    position = drive.channel("position")
    found = cleaned(drive.with_channel(position.replace(values=position.values + ahead)))
    assert "neither" not in found.provenance.get("warnings", "")
