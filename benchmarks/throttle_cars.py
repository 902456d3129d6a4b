# SPDX-License-Identifier: Apache-2.0
"""Small cars driven by throttle: predictions 1 s and 3 s ahead of unseen drives, and what is said of them.

Each is drawn: tyres soft or stiff, a motor, a servo, a point that a camera tracks, noise. Four drives of twenty seconds are
fitted, two are not. The peer is the same simulator with the hidden values: where it begins a prediction is as noisy as ours.
"""

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import argparse
import tempfile
from pathlib import Path

import numpy as np
from driven_cars import Car, driven, off, written
from numpy.typing import NDArray
from results import result

from trueup import formats
from trueup.engines.vehicle import Vehicle, VehicleSimulator
from trueup.loop.prepare import prepare
from trueup.recording import Recording

Array = NDArray[np.float64]

AHEAD = (1.0, 3.0)  # s
SECONDS, FITTED, UNSEEN = 20.0, 4, 2
_STEP = 0.002  # s by which the drawn cars are early: their own step
SHOWN = (
    "steering_left",
    "steering_right",
    "pose_at",
    "understeer",
    "friction_limit",
    "grip",
    "weight_in_front",
    "yaw_inertia",
)
"""Whose intervals are judged, where they are called identified."""


def drawn(rng: np.random.Generator) -> Car:
    """A car of a tenth of the size, as clubs and courses build them."""
    wheelbase = float(rng.uniform(0.15, 0.35))
    motor = (
        float(rng.uniform(6.0, 15.0)), float(rng.uniform(0.03, 0.12)), float(rng.uniform(0.03, 0.15)),
        float(rng.uniform(0.3, 1.0)), float(rng.uniform(0.3, 1.5)),
    )  # fmt: skip
    soft = 10.0 ** rng.uniform(np.log10(35.0), np.log10(150.0))
    return Car(
        "by throttle", wheelbase, (0.2, 0.55), float(rng.choice([30.0, 50.0, 100.0])),
        ("t", "throttle", "steering", "x", "y", "yaw"), lambda r: [float(v) for v in r[:6]],
        steers=float(rng.uniform(0.3, 0.5)), delays=(float(rng.uniform(0.02, 0.08)), float(rng.uniform(0.02, 0.08))),
        turns=float(rng.uniform(3.0, 8.0)), lag=float(rng.uniform(0.02, 0.08)),
        scale=(float(rng.uniform(0.9, 1.1)), float(rng.uniform(0.9, 1.1))), offset=float(rng.normal(0.0, 0.01)),
        stiffness=(soft * float(rng.uniform(0.8, 1.0)), soft), friction=float(rng.uniform(5.0, 9.0)),
        inertia=float(rng.uniform(0.7, 1.3)), noise=(10.0 ** rng.uniform(-3.3, -2.5), 10.0 ** rng.uniform(-3.0, -2.3)),
        motor=motor, weight=float(rng.uniform(0.42, 0.58)), tracked=float(rng.uniform(0.0, 1.0)) * wheelbase,
    )  # fmt: skip


def hidden(car: Car) -> dict[str, float]:
    """What the calibrated simulator would have to find."""
    assert car.motor is not None
    drive, dead, fade, friction, loss = car.motor
    still = dict.fromkeys(
        ("push_lasts", "trim_lasts", "pose_turn", "steering_slack", "relaxation", "curve_loss",
         "throttle_lag"), 0.0)  # fmt: skip
    left, right = (car.steers * s for s in car.scale)
    return still | {
        "speed_kept": 1.0, "drive": drive, "throttle_dead": dead, "drive_fade": fade, "friction": friction,
        "speed_loss": loss, "throttle_delay": car.delays[0], "steering_delay": car.delays[1] - _STEP, "steering_lag": car.lag,
        "steering_rate_limit": car.turns / car.steers, "steering_left": left, "steering_right": right,
        "steering_falloff": 0.0,
        "steering_offset": car.offset / (0.5 * (left + right)), "understeer": 1.0 / car.stiffness[0] - 1.0 / car.stiffness[1],
        "grip": car.stiffness[1], "friction_limit": car.friction, "yaw_inertia": car.inertia, "weight_in_front": car.weight,
        "pose_at": car.tracked / car.wheelbase,
    }  # fmt: skip


def logged(car: Car, rng: np.random.Generator, folder: Path, name: str, count: int) -> list[Recording]:
    """Drives, written as CSV and read back."""
    files = [written(car, driven(car, SECONDS, rng), folder / f"{name}_{n}.csv") for n in range(count)]
    return [recording for file in files for recording in formats.read(file)]


def main() -> None:
    """Prints a line a car, and the RESULT lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two cars")
    parser.add_argument("--first", type=int, default=0, help="number of the first car")
    parser.add_argument("--cars", type=int, default=12)
    options = parser.parse_args()
    print("car     1 s / 3 s ahead, mm   with the hidden values   CPU s   called identified: found (hidden)")
    rows, claims = [], []
    for seed in range(options.first, options.first + (2 if options.quick else options.cars)):
        rng = np.random.default_rng([seed, 2028])
        car = drawn(rng)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "car.toml"
            file.write_text(f"[vehicle]\nwheelbase = {car.wheelbase:.4f}\n")
            training = logged(car, rng, Path(folder), "fitted", FITTED)
            unseen = logged(car, rng, Path(folder), "unseen", UNSEEN)
            ready = prepare(file, training)
            done = ready.calibrate()
        assert isinstance(ready.simulator, VehicleSimulator)
        values = hidden(car)
        truth = VehicleSimulator(Vehicle("truth", car.wheelbase, drive="throttle", values=values))
        ours, theirs = off(ready.simulator, done.values, unseen, AHEAD), off(truth, np.zeros(0), unseen, AHEAD)
        rows.append((*ours, *theirs))
        found = {e.name: e for e in done.estimates}
        named = [found[n] for n in SHOWN if n in found and found[n].verdict == "identified"]
        claims += [e.low <= values[e.name] <= e.high for e in named]
        words = ", ".join(
            f"{e.name} {e.value:.3g} ({values[e.name]:.3g}{'' if e.low <= values[e.name] <= e.high else ', outside'})"
            for e in named
        )
        print(f"{seed:3d} {1e3 * ours[0]:10.1f} / {1e3 * ours[1]:6.1f} {1e3 * theirs[0]:14.1f} / {1e3 * theirs[1]:6.1f} "
              f"{done.cpu_seconds:9.1f}   {words}", flush=True)  # fmt: skip
    ours, theirs = np.exp(np.log(np.array(rows)).mean(axis=0)).reshape(2, 2)[:, 1]
    worst = float(max(row[1] / row[3] for row in rows))
    peer = f"the hidden values, {len(rows)} cars"
    result(
        "throttle_cars_3s", float(ours), "m, geometric mean", 1.5, peer=peer, peer_value=float(theirs), ratio_goal=True
    )
    result("throttle_cars_3s_at_worst", worst, "of what the hidden values give", 3.0)
    result("throttle_cars_coverage", float(np.mean(claims)), f"of {len(claims)} called identified", 0.9, at_most=False)


if __name__ == "__main__":
    main()
