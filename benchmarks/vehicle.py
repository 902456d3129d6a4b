# SPDX-License-Identifier: Apache-2.0
"""Closed-loop drives of 170 s at 50 Hz: the compiled vehicle with the Stanley law, beside a loop in numpy over the same."""

from __future__ import annotations

import argparse
import os
import time

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from numpy.typing import NDArray
from results import result

from trueup.controllers.controller import Observation
from trueup.controllers.stanley import GAINS
from trueup.engines.vehicle import BETAS
from trueup.studies.stanley import chasi
from trueup.trial import Trial

Array = NDArray[np.float64]

PERIOD = 0.02  # s


def numpy_loop(trial: Trial, betas: Array, controller: object) -> Array:
    """(b, T, 2) the path by a plain loop over time, all b vehicles at once: the five betas as Table II has them."""
    ticks = round(trial.duration / PERIOD)
    rows, vehicle = len(betas), chasi.CHASI
    pose = np.tile([*trial.initial["position"].values[0], trial.initial["heading"].values[0, 0]], (rows, 1))
    speed, rate = np.zeros(rows), np.zeros(rows)
    orders, path = np.zeros((ticks, rows, 2)), np.empty((rows, ticks + 1, 2))
    path[:, 0] = pose[:, :2]
    everyone = np.arange(rows)
    controller.reset(Observation(0.0, pose, np.stack([speed, rate], axis=1), {}, trial))  # type: ignore[attr-defined]
    for n in range(ticks):
        seen = Observation(n * PERIOD, pose, np.stack([speed, rate], axis=1), {}, trial)
        orders[n] = controller.command(seen)  # type: ignore[attr-defined]
        arrived = []
        for column in (0, 1):
            at = n - betas[:, column] / PERIOD
            i = np.clip(np.floor(at).astype(int), 0, n)
            part = np.where(at >= n, 0.0, at - i)
            held = orders[i, everyone, column]
            later = orders[np.minimum(i + 1, n), everyone, column]
            early = orders[0, :, column] * (1.0 - np.clip(-at, 0.0, 1.0))
            arrived.append(np.where(at < 0.0, early, held + part * (later - held)))
        wanted, steering = arrived[0], np.clip(arrived[1], -vehicle.max_steering, vehicle.max_steering)
        speed = speed + np.clip(wanted - speed, -betas[:, 2] * PERIOD, betas[:, 2] * PERIOD)
        turn = np.clip(speed * np.tan(steering) / vehicle.wheelbase, -betas[:, 3], betas[:, 3])
        rate = rate + np.clip(turn - rate, -betas[:, 4] * PERIOD, betas[:, 4] * PERIOD)
        half = 0.5 * rate * PERIOD
        chord = speed * PERIOD * np.sinc(half / np.pi)
        pose = pose + np.stack(
            [chord * np.cos(pose[:, 2] + half), chord * np.sin(pose[:, 2] + half), 2.0 * half], axis=1
        )
        path[:, n + 1] = pose[:, :2]
    return path


def loop_seconds(drives: int) -> float:
    """CPU seconds that so many drives of the study take in the plain loop, 64 of them in one array, the best of two."""
    task = chasi.task(gains=GAINS)
    rows = 64
    betas = np.random.default_rng(0).uniform([0.0, 0.0, 0.4, 0.9, 1.0], [0.4, 0.25, 1.0, 1.5, 4.0], (rows, 5))
    times = []
    for _ in range(2):
        begun = time.process_time()
        numpy_loop(task.trials[0], betas, task.controllers(np.ones((rows, 3))))
        times.append(time.process_time() - begun)
    return min(times) * drives / rows


def main() -> None:
    """Prints rates and how far the two drive apart."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer drives")
    options = parser.parse_args()
    count = 16 if options.quick else 64
    task = chasi.task(gains=GAINS)
    trial = task.trials[0]
    rng = np.random.default_rng(0)
    betas = rng.uniform([0.0, 0.0, 0.4, 0.9, 1.0], [0.4, 0.25, 1.0, 1.5, 4.0], (count, 5))
    gains = rng.uniform(0.5, 2.0, (count, 3))
    simulator = chasi.simulator(BETAS, 0.0, 0.0)
    rows = np.concatenate([betas, gains], axis=1)
    simulator.rollout([trial], rows[:1], task.controllers)  # compiles
    took = []
    for _ in range(3):
        began = time.perf_counter()
        simulator.rollout([trial], rows, task.controllers)
        took.append(time.perf_counter() - began)
    best = min(took)
    (driven,) = simulator.rollout([trial], rows, task.controllers)
    began = time.perf_counter()
    slow = numpy_loop(trial, betas, task.controllers(gains))
    loop = time.perf_counter() - began
    at = np.round(trial.observed["position"].time / PERIOD, 6)
    low = np.minimum(at.astype(int), slow.shape[1] - 2)
    between = slow[:, low] + (at - low)[None, :, None] * (slow[:, low + 1] - slow[:, low])
    apart = float(np.abs(between - driven.channels["position"]).max())
    steps = count * trial.duration / PERIOD
    print(f"{count} drives of {trial.duration:.0f} s at 50 Hz, five betas, Stanley in the loop")
    print(f"compiled    {best:8.3f} s  {1e9 * best / steps:8.0f} ns a step")
    print(f"numpy loop  {loop:8.3f} s  {1e9 * loop / steps:8.0f} ns a step   (all drives in one array)")
    print(f"paths differ by {apart:.2g} m at most")
    result("rollouts_per_second", count / best, "1/s", 20.0, peer="numpy loop", peer_value=count / loop, at_most=False,
           ratio_goal=True)  # fmt: skip
    result("vehicle_paths_apart", apart, "m", 1e-9)


if __name__ == "__main__":
    main()
