# SPDX-License-Identifier: Apache-2.0
"""Cars whose wheels need more angle than geometry says, or none for small commands, or slip behind, before tyres slide."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trueup.arrays import Array
from trueup.calibration import Estimate
from trueup.loop.calibrate import Options
from trueup.loop.fit import DESCENT
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording

STEP, WHEELBASE, SPEED_SCALE = 0.005, 0.33, 0.97  # s, m
TURNING = ("steering_*", "understeer", "pose_*", "speed_*", "relaxation")


def driven(
    understeer: float, gain: float, dead: float = 0.0, seed: int = 0, *, grip: float = np.inf, fast: float = 1.0
) -> Recording:
    """40 s of steps of speed and steering, told in m/s and rad, with noise of 2 mm and 3 mrad; 2.5 m/s^2 sideways, `fast`
    times as much at as many times the speed. With `grip` (m/s^2 per rad, of both axles) tyres have to slip for their force.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 40.0, STEP)
    held = (time / 0.8).astype(int), (time / 2.5).astype(int)
    steering = rng.uniform(-0.3, 0.3, 1 + held[0][-1])[held[0]] / fast
    asked = fast * rng.uniform(0.6, 1.8, 1 + held[1][-1])[held[1]]
    turned = np.sign(steering) * np.maximum(np.abs(steering) - dead, 0.0)
    speed, wheel, late, told = np.zeros(len(time)), np.zeros(len(time)), round(0.1 / STEP), 0.0
    for k in range(1, len(time)):
        speed[k] = speed[k - 1] + 4.0 * STEP * (SPEED_SCALE * asked[max(k - 10, 0)] - speed[k - 1])
        told += (1.0 - np.exp(-STEP / 0.06)) * (turned[max(k - late, 0)] - told)
        wheel[k] = gain * told
    turn = speed * np.tan(wheel) / (WHEELBASE + understeer * speed**2)
    aside = np.zeros(len(time)) if np.isinf(grip) else slipping(speed, wheel, turn, grip)
    heading = np.cumsum(STEP * turn)
    course = heading + aside
    way = np.cumsum(STEP * speed[:, None] * np.stack([np.cos(course), np.sin(course)], axis=1), axis=0)
    kept = slice(None, None, round(0.02 / STEP))
    pose = (
        way[kept] + rng.normal(0.0, 2e-3, (len(time[kept]), 2)),
        heading[kept] + rng.normal(0.0, 3e-3, len(time[kept])),
    )
    command = np.stack([asked, steering], axis=1)[kept]
    return Recording("steps", {
        "command": Channel("command", ("speed", "steering"), "m/s", time[kept], command, ("m/s", "rad")),
        "position": Channel("position", ("x", "y"), "m", time[kept], pose[0]),
        "heading": Channel("heading", ("heading",), "rad", time[kept], pose[1][:, None]),
    })  # fmt: skip


def slipping(speed: Array, wheel: Array, turn: Array, grip: float) -> Array:
    """(T,) angles at which the rear axle goes aside; puts the turn rates of this car into `turn` (rad/s).

    A bicycle with its mass in the middle, as hard to turn as if half of it were over each axle.
    """
    sideways, rate, half, aside = 0.0, 0.0, 0.5 * WHEELBASE, np.zeros(len(speed))
    for k, (v, angle) in enumerate(zip(speed.tolist(), wheel.tolist(), strict=True)):
        along = max(v, 0.5)
        front = 0.5 * grip * (angle * min(v / 0.5, 1.0) - (sideways + half * rate) / along)
        rear = -0.5 * grip * (sideways - half * rate) / along
        sideways += STEP * (front + rear - v * rate)
        rate += STEP * (front - rear) / half
        turn[k], aside[k] = rate, (sideways - half * rate) / along
    return aside


def calibrated(folder: Path, drive: Recording, *more: str) -> dict[str, Estimate]:
    """Of what tells how it turns, and `more`, where nothing lasts beyond the model."""
    lasting = "push_lasts = 0.0\ntrim_lasts = 0.0\nspeed_kept = 0.0\n"
    (folder / "car.toml").write_text(f"[vehicle]\nwheelbase = {WHEELBASE}\n[vehicle.values]\n{lasting}")
    ready = prepare(folder / "car.toml", [drive]).only((*TURNING, *more))
    return {e.name: e for e in ready.calibrate(Options(stages=DESCENT, cross_validate=False, lacking=False)).estimates}


def test_what_steering_is_worth_is_found_in_calm_curves_of_a_car_that_understeers(tmp_path: Path) -> None:
    found = calibrated(tmp_path, driven(0.02, 0.95))
    assert found["understeer"].value == pytest.approx(0.02, abs=6e-3)
    assert not found["steering_dead"].fitted
    for side in ("steering_left", "steering_right"):
        assert found[side].value == pytest.approx(0.95, rel=0.03)
        assert found[side].low <= 0.95 <= found[side].high


def test_steering_that_small_commands_do_not_move_is_found(tmp_path: Path) -> None:
    found = calibrated(tmp_path, driven(0.005, 0.95, dead=0.04))
    assert found["steering_dead"].value == pytest.approx(0.04, abs=4e-3)
    for side in ("steering_left", "steering_right"):
        assert found[side].value == pytest.approx(0.95, rel=0.03)


@pytest.mark.parametrize("grip", [50.0, np.inf])
def test_tyres_that_slip_behind_are_found_where_they_do(tmp_path: Path, grip: float) -> None:
    found = calibrated(tmp_path, driven(0.0, 0.95, grip=grip, fast=2.0), "grip")
    if np.isinf(grip):
        assert not found["grip"].fitted or found["grip"].value >= 200.0
    else:
        assert found["grip"].value == pytest.approx(grip, rel=0.1)
    for side in ("steering_left", "steering_right"):
        assert found[side].value == pytest.approx(0.95, rel=0.04)
