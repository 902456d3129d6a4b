# SPDX-License-Identifier: Apache-2.0
"""Robots with two driven wheels whose logs command a left and a right wheel: predictions 1 s and 3 s ahead of unseen drives.

Two simulated robots of another structure than trueup's: a lag of each motor, dead time, limited acceleration, wheels of two
sizes, turns that scrub, a track that is declared a little wrong. Each is logged as several programs write it; four drives of
30 s are fitted, three are not. The peer rolls by the file's track and radius from the same states. Told by PWM, with motors
that stand still below some share of it or none, the peer is the same calibration without such a dead zone.
"""

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import argparse
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from results import result

from trueup.engines.vehicle import VehicleSimulator
from trueup.engines.vehicle.commands import with_commands
from trueup.engines.vehicle.prediction import prediction_errors
from trueup.engines.vehicle.vehicle_file import read_vehicle
from trueup.formats import read
from trueup.loop.prepare import prepare
from trueup.recording import Recording
from trueup.tracking.past import begun_at
from trueup.trial import Trial

Array = NDArray[np.float64]

_STEP, _PERIOD, _HORIZONS = 0.002, 0.02, (1.0, 3.0)  # s
_FITTED, _UNSEEN, _LENGTH = 4, 3, 30.0  # drives, drives, s


@dataclass(frozen=True)
class Robot:
    """What is true of one, and what its file says; lengths in m, SI throughout."""

    name: str
    track: float
    declared: float
    """The track that the file has."""
    radius: tuple[float, float]
    nominal: float
    lag: tuple[float, float]
    dead: float
    """Time."""
    fastest: float
    quickest: float
    """Change of a wheel's speed."""
    scrub: float
    """Share of the turn that is lost."""
    noise: float
    counts: float = 1440.0


ROBOTS = (
    Robot("small", 0.148, 0.143, (0.0322, 0.0330), 0.0325, (0.06, 0.08), 0.08, 0.35, 1.2, 0.04, 0.003),
    Robot("big", 0.545, 0.56, (0.0985, 0.0972), 0.0975, (0.15, 0.17), 0.15, 0.9, 0.8, 0.10, 0.005),
)


def _asked(robot: Robot, rng: np.random.Generator) -> Array:
    """(n, 2) what the wheels are told in m/s: curves, straights, turns on the spot, backwards, swings."""
    out: list[Array] = []
    while sum(map(len, out)) < _LENGTH / _PERIOD:
        kind, count = rng.choice(5, p=[0.42, 0.18, 0.12, 0.1, 0.18]), int(rng.uniform(1.0, 3.0) / _PERIOD)
        speed, k = rng.uniform(0.4, 0.85) * robot.fastest, np.arange(count)
        turn = {
            0: rng.uniform(-0.5, 0.5) + 0.0 * k, 1: 0.0 * k, 2: rng.uniform(0.2, 0.4) * rng.choice([-1.0, 1.0]) + 0.0 * k,
            3: rng.uniform(-0.15, 0.15) + 0.0 * k,
            4: rng.uniform(0.1, 0.35) * np.sin(2.0 * np.pi * rng.uniform(0.3, 0.9) * _PERIOD * k),
        }[int(kind)] * robot.fastest  # fmt: skip
        along = {2: 0.0, 3: -0.5 * speed}.get(int(kind), speed)
        out.append(np.stack([along - turn, along + turn], axis=1)[: count // 2 if kind in (2, 3) else count])
    told = np.concatenate(out)[: round(_LENGTH / _PERIOD)]
    return np.clip(told, -robot.fastest, robot.fastest)


def driven(robot: Robot, rng: np.random.Generator, still: float = 0.0) -> Array:
    """(n, 10) rows of a drive: t, left and right told (m/s), x, y, heading, rates (rad/s) and angles of the wheels (rad).

    Below `still`, a share of its greatest speed, a motor does not turn.
    """
    told, every = _asked(robot, rng), round(_PERIOD / _STEP)
    late, rows = round(robot.dead / _STEP), []
    x = y = heading = turning = 0.0
    rate, angle = np.zeros(2), np.zeros(2)
    for k in range(every * len(told)):
        if k % every == 0:
            rows.append([_STEP * k, *told[k // every], x, y, heading, *rate, *angle])
        wanted = told[max(k - late, 0) // every] / robot.fastest
        wanted = (wanted - np.clip(wanted, -still, still)) / (1.0 - still) * robot.fastest / robot.nominal
        most = robot.quickest / robot.nominal
        rate = rate + _STEP * np.clip((wanted - rate) / np.array(robot.lag), -most, most)
        left, right = rate * robot.radius
        turning += _STEP * ((right - left) / robot.track * (1.0 - robot.scrub) - turning) / 0.03
        speed = 0.5 * (left + right) * (1.0 - 0.02 * abs(turning))
        x += _STEP * speed * np.cos(heading + 0.5 * _STEP * turning)
        y += _STEP * speed * np.sin(heading + 0.5 * _STEP * turning)
        heading, angle = heading + _STEP * turning, angle + _STEP * rate
    table = np.array(rows)
    table[:, 3:6] += rng.normal(0.0, robot.noise, (len(table), 3))
    return table


def _counts(angle: Array, robot: Robot) -> Array:
    return np.floor(angle * robot.counts / (2.0 * np.pi))


def _ros(r: Robot, t: Array) -> dict[str, Array]:
    pose = "odom.pose.pose."
    return {
        "time": t[:, 0], "left_wheel_velocity_command": t[:, 1] / r.nominal,
        "right_wheel_velocity_command": t[:, 2] / r.nominal,
        f"{pose}position.x": t[:, 3], f"{pose}position.y": t[:, 4], f"{pose}orientation.z": np.sin(0.5 * t[:, 5]),
        f"{pose}orientation.w": np.cos(0.5 * t[:, 5]), "left_wheel_velocity": t[:, 6], "right_wheel_velocity": t[:, 7],
    }  # fmt: skip


def _millimetres(r: Robot, t: Array) -> dict[str, Array]:
    left, right = (np.mod(_counts(t[:, k], r) + 32000.0, 65536.0) for k in (8, 9))
    return {
        "t": t[:, 0], "left_wheel_cmd_mmps": 1e3 * t[:, 1], "right_wheel_cmd_mmps": 1e3 * t[:, 2], "mocap_x": t[:, 3],
        "mocap_y": t[:, 4], "mocap_yaw": np.mod(t[:, 5] + np.pi, 2.0 * np.pi) - np.pi, "left_encoder_counts": left,
        "right_encoder_counts": right,
    }  # fmt: skip


def _references(r: Robot, t: Array) -> dict[str, Array]:
    names = ("t", "v_l_ref", "v_r_ref", "vl", "vr", "x", "y", "th")
    return dict(zip(names, (*t[:, :3].T, *(t[:, 6:8] * r.nominal).T, *t[:, 3:6].T), strict=True))


def _turns(r: Robot, t: Array) -> dict[str, Array]:
    left, right = (t[:, 1:3] / r.nominal * 30.0 / np.pi).T
    return {"t": t[:, 0], "cmd_left": left, "cmd_right": right, "x": t[:, 3], "y": t[:, 4], "yaw": t[:, 5]}


def _pwm(r: Robot, t: Array) -> dict[str, Array]:
    left, right = np.round(255.0 * t[:, 1:3] / r.fastest).T
    return {"ms": 1e3 * t[:, 0], "pwm_left": left, "pwm_right": right, "x": t[:, 3], "y": t[:, 4], "yaw": t[:, 5]}


LOGS: dict[str, Callable[[Robot, Array], dict[str, Array]]] = {
    "ROS, rad/s, no unit": _ros, "mm/s, counts": _millimetres, "v_l_ref": _references, "rpm, no unit": _turns,
}  # fmt: skip


def _rolled(simulator: VehicleSimulator, recording: Recording) -> Array:
    """(n, 2) errors in m 1 s and 3 s ahead of wheels that roll as they are told."""
    clean = simulator.prepared(recording)
    past = simulator.past(Trial.of(clean, simulator.observable(clean)))
    found = []
    for k in begun_at(past, max(_HORIZONS), 0.25):
        x, y, heading = past.seen[k, :3]
        for i in range(round(max(_HORIZONS) / past.step)):
            speed, turn = past.commands[k + i]
            x += past.step * speed * np.cos(heading + 0.5 * past.step * turn)
            y += past.step * speed * np.sin(heading + 0.5 * past.step * turn)
            heading += past.step * turn
            if any(i + 1 == round(h / past.step) for h in _HORIZONS):
                found.append(np.hypot(x - past.seen[k + i + 1, 0], y - past.seen[k + i + 1, 1]))
    return np.reshape(found, (-1, len(_HORIZONS)))


def _logged(
    robot: Robot,
    style: Callable[[Robot, Array], dict[str, Array]],
    still: float,
    rng: np.random.Generator,
    folder: Path,
) -> tuple[Path, list[Recording]]:
    """The robot's file, and its drives as they are read from theirs."""
    file = folder / "robot.toml"
    file.write_text(
        f"[vehicle]\ntrack = {robot.declared}\nwheel_radius = {robot.nominal}\ncounts_per_turn = {robot.counts}\n",
        encoding="utf-8",
    )
    logs = []
    for k in range(_FITTED + _UNSEEN):
        columns = style(robot, driven(robot, rng, still))
        path = folder / f"drive_{k}.csv"
        np.savetxt(path, np.stack(list(columns.values()), axis=1), "%.6f", ",", header=",".join(columns), comments="")
        logs.append(read([path])[0])
    return file, logs


def _judged(robot: Robot, style: str, folder: Path) -> tuple[Array, Array]:
    """(2,) mean errors in m of the calibrated robot and of its file's numbers."""
    rng = np.random.default_rng([ROBOTS.index(robot), list(LOGS).index(style)])
    file, logs = _logged(robot, LOGS[style], 0.0, rng, folder)
    ready = prepare(file, logs[:_FITTED])
    found = ready.calibrate()
    calibrated = ready.simulator
    assert isinstance(calibrated, VehicleSimulator)
    plain = VehicleSimulator(with_commands(read_vehicle(file), logs[:_FITTED])[0])
    ours = [prediction_errors(calibrated, found.values, calibrated.prepared(r)) for r in logs[_FITTED:]]
    theirs = [_rolled(plain, r) for r in logs[_FITTED:]]
    return np.concatenate(ours).mean(axis=0), np.concatenate(theirs).mean(axis=0)


def _by_pwm(robot: Robot, still: float, folder: Path) -> tuple[float, Array, Array]:
    """The dead zone that was found, as a share of the greatest PWM, and (2,) errors in m with it and without any."""
    rng = np.random.default_rng([ROBOTS.index(robot), int(100 * still), 9])
    file, logs = _logged(robot, _pwm, still, rng, folder)
    ready, errors, dead = prepare(file, logs[:_FITTED]), [], 0.0
    simulator = ready.simulator
    assert isinstance(simulator, VehicleSimulator)
    full = simulator.vehicle.full or (1.0, 1.0)
    for space in (simulator.parameters, simulator.parameters.left_out(["wheel_dead"])):
        tried = simulator.with_parameters(space)
        found = replace(ready, simulator=tried).calibrate()
        dead = dead or next(e.value for e in found.estimates if e.name == "wheel_dead") * full[0] / 255.0
        errors.append(
            np.concatenate([prediction_errors(tried, found.values, tried.prepared(r)) for r in logs[_FITTED:]])
        )
    return dead, errors[0].mean(axis=0), errors[1].mean(axis=0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one robot, one way to log")
    quick = parser.parse_args().quick
    print(f"{'':26}  calibrated, mm 1 s / 3 s   file's track and radius")
    ratios = []
    for robot in ROBOTS[: 1 if quick else None]:
        for style in list(LOGS)[: 1 if quick else None]:
            with tempfile.TemporaryDirectory() as folder:
                ours, theirs = _judged(robot, style, Path(folder))
            ratios.append(ours[1] / theirs[1])
            shown = "   ".join(f"{1e3 * a:9.1f} /{1e3 * b:7.1f}     " for a, b in (ours, theirs))
            print(f"{robot.name:6}{style:20}  {shown}", flush=True)
    said = "rolling by the file's track and radius"
    result("two_wheels_3s_over_rolling", float(np.exp(np.mean(np.log(ratios)))), "", 0.5, peer=said)
    result("two_wheels_3s_over_rolling_at_worst", float(max(ratios)), "", 1.0, peer=said)
    print("\nby PWM   still below   found   3 s ahead, mm   without a dead zone")
    every = []
    for robot in ROBOTS[: 1 if quick else None]:
        for still in (0.2,) if quick else (0.0, 0.08, 0.2):
            with tempfile.TemporaryDirectory() as folder:
                dead, ours, theirs = _by_pwm(robot, still, Path(folder))
            every.append((ours[1], theirs[1]))
            print(f"{robot.name:6} {still:13.2f} {dead:7.3f} {1e3 * ours[1]:15.1f} {1e3 * theirs[1]:17.1f}", flush=True)
    ours, theirs = np.exp(np.mean(np.log(every), axis=0)).tolist()
    result("two_wheels_pwm_3s", ours, "m", 1.0, peer="without a dead zone", peer_value=theirs, ratio_goal=True)


if __name__ == "__main__":
    main()
