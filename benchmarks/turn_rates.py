# SPDX-License-Identifier: Apache-2.0
"""Robots on two driven wheels commanded by speed and turn rate, as ROS does: predictions 1 s and 3 s ahead of unseen drives.

Each is drawn: a stiff or soft speed controller with limits of its own, a lag and a dead time of both commands, a gain of the
turn rate, a tracker's noise. It stands when a log begins, which is when it is first commanded. Six drives of six seconds are
fitted, six are not. The peer is the same simulator with the hidden values: where it begins a prediction is as noisy as ours.
"""

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import argparse
import math
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from driven_cars import off
from numpy.typing import NDArray
from results import result

from trueup import formats
from trueup.engines.vehicle import Vehicle, VehicleSimulator
from trueup.engines.vehicle.vehicle import TURNED
from trueup.loop.prepare import prepare
from trueup.recording import Recording

Array = NDArray[np.float64]

STEP, EVERY, PHASE, SECONDS = (
    0.002,
    10,
    1.2,
    6.0,
)  # s of the hidden robot; its steps a sample; s of one command, of a drive
AHEAD = (1.0, 2.9)  # s


@dataclass(frozen=True)
class Robot:
    """The hidden robot: limits in m/s^2, gain in 1/s (inf: it has its speed at once), times in s, noise in m and rad."""

    up: float
    down: float
    gain: float
    turn: float
    lag: float
    delay: float
    noise: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Robot:
        """Small robots as they are sold."""
        up, down, stiff = rng.uniform(0.5, 3.0), rng.uniform(0.5, 4.0), rng.random() < 0.5
        gain = math.inf if stiff else float(rng.uniform(2.0, 12.0))
        times = float(rng.uniform(0.03, 0.2)), float(rng.choice([0.0, 0.04, 0.1]))
        return cls(up, down, gain, float(rng.uniform(0.85, 1.1)), *times, 10.0 ** rng.uniform(-3.3, -2.3))

    def driven(self, rng: np.random.Generator) -> Array:
        """(300, 6) time, speed and turn rate commanded, and x, y, heading with noise."""
        x = y = psi = v = w = 0.0
        rows: list[list[float]] = []
        phases = round(SECONDS / PHASE)
        told = [((0.0, -0.4, rng.uniform(0.3, 1.0))[k % 3], rng.uniform(-1.2, 1.2)) for k in range(phases)]
        for k in range(round(SECONDS / STEP)):
            late = k - round(self.delay / STEP)
            speed, turn = told[int(late * STEP / PHASE)] if late >= 0 else (0.0, 0.0)
            if k % EVERY == 0:
                rows.append([STEP * k, *told[int(k * STEP / PHASE)], x, y, psi])
            v += STEP * min(max(min(self.gain, 1.0 / STEP) * (speed - v), -self.down), self.up)
            w += STEP / self.lag * (self.turn * turn - w)
            x, y, psi = x + STEP * v * math.cos(psi), y + STEP * v * math.sin(psi), psi + STEP * w
        table = np.array(rows)
        return table + rng.normal(0.0, self.noise, table.shape) * [0, 0, 0, 1, 1, 1]

    @property
    def values(self) -> dict[str, float]:
        """What the calibrated simulator would have to find."""
        exact = dict.fromkeys(("push_lasts", "trim_lasts", "pose_ahead", "pose_turn", "turn_offset", "speed_lag"), 0.0)
        pursuit = {"speed_gain": min(self.gain, 50.0), "acceleration_limit": self.up, "braking_limit": self.down}
        turning = {"turn_left": self.turn, "turn_right": self.turn, "turn_lag": self.lag, "turn_change_limit": 50.0}
        delays = {"speed_delay": self.delay, "turn_delay": self.delay}
        return exact | pursuit | turning | delays | {"speed_kept": 1.0, "speed_scale": 1.0}


def logged(robot: Robot, rng: np.random.Generator, folder: Path, name: str) -> list[Recording]:
    """Six drives, written as CSV and read back."""
    header, read = "t,cmd_vel.linear.x,cmd_vel.angular.z,x,y,theta", []
    for n in range(6):
        file = folder / f"{name}_{n}.csv"
        np.savetxt(file, robot.driven(rng), delimiter=",", header=header, comments="")
        read += formats.read(file)
    return read


def main() -> None:
    """Prints a line a robot, and the RESULT lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="four robots")
    parser.add_argument("--first", type=int, default=0, help="number of the first robot")
    parser.add_argument("--robots", type=int, default=16)
    options = parser.parse_args()
    print("robot   1 s / 3 s ahead, mm   with the hidden values   up, down found (hidden)           CPU s")
    rows, claims = [], []
    for seed in range(options.first, options.first + (4 if options.quick else options.robots)):
        rng = np.random.default_rng([seed, 2027])
        robot = Robot.drawn(rng)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "base.toml"
            file.write_text("[vehicle]\nwheelbase = 0.4\n")
            training, unseen = (logged(robot, rng, Path(folder), name) for name in ("fitted", "unseen"))
            ready = prepare(file, training)
            done = ready.calibrate()
        assert isinstance(ready.simulator, VehicleSimulator)
        truth = VehicleSimulator(Vehicle("truth", 0.4, drive=TURNED, values=robot.values))
        ours, theirs = off(ready.simulator, done.values, unseen, AHEAD), off(truth, np.zeros(0), unseen, AHEAD)
        rows.append((*ours, *theirs))
        found = {e.name: e for e in done.estimates}
        hidden = {n: robot.values[n] for n in ("acceleration_limit", "braking_limit", "turn_left", "turn_right")}
        claims += [found[n].low <= t <= found[n].high for n, t in hidden.items() if found[n].verdict == "identified"]
        limits = [f"{found[n].value:.2f} ({hidden[n]:.2f})" for n in ("acceleration_limit", "braking_limit")]
        print(f"{seed:5d} {1e3 * ours[0]:8.1f} / {1e3 * ours[1]:6.1f} {1e3 * theirs[0]:14.1f} / {1e3 * theirs[1]:6.1f}     "
              f"{', '.join(limits):32s} {done.cpu_seconds:6.1f}", flush=True)  # fmt: skip
    ours, theirs = np.exp(np.log(np.array(rows)).mean(axis=0)).reshape(2, 2)[:, 1]
    worst = float(max(row[1] / row[3] for row in rows))
    named = f"the hidden values, {len(rows)} robots"
    result(
        "turn_rates_3s", float(ours), "m, geometric mean", 1.5, peer=named, peer_value=float(theirs), ratio_goal=True
    )
    result("turn_rates_3s_at_worst", worst, "of what the hidden values give", 3.0)
    result("turn_rates_coverage", float(np.mean(claims)), f"of {len(claims)} called identified", 0.9, at_most=False)


if __name__ == "__main__":
    main()
