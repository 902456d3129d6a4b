# SPDX-License-Identifier: Apache-2.0
"""Simulated servos on a bench, finer in time than any fit, logged as buses log them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trueup.actuators.bench import Bench, runs_of
from trueup.actuators.replay import replay
from trueup.actuators.servo import Law
from trueup.recording import Channel, Recording

BENCH = Bench(mass=0.5, length=0.1, inertia=2e-4)
ENCODER = 2.0 * np.pi / 4096.0


def commands(kind: str, time: np.ndarray) -> np.ndarray:
    """What the servo is told; NaN while it is switched off."""
    if kind == "steps":
        return np.repeat([0.8, -0.4, 0.2, 1.2, -1.0, 0.5, 0.0, -1.3], int(np.ceil(len(time) / 8)))[: len(time)]
    if kind == "sines":
        return 0.9 * np.sin(3.0 * time) + 0.4 * np.sin(7.3 * time)
    if kind == "slow":
        return 1.2 * np.abs((0.5 * time) % 2.0 - 1.0) - 0.3
    if kind == "chirp":
        return 0.7 * np.sin(1.2 * time**2)
    return np.where(time < 0.25 * time[-1], 1.3, np.nan)  # lifted, then dropped


def logged(law: Law, kind: str, rng: np.random.Generator, *, seconds: float = 4.0, bench: Bench = BENCH, rate: float = 150.0,
           gain: float = 1.0) -> Recording:  # fmt: skip
    """A recording of a servo with this law, simulated with steps of 0.5 ms, read by an encoder with a little noise."""
    time = np.arange(0.0, seconds, 1.0 / rate)
    time = time + rng.uniform(0.0, 0.2 / rate, len(time))
    command = commands(kind, time)

    def channels(position: np.ndarray) -> Recording:
        values = {"command": command, "position": position}
        parts = {n: Channel(n, ("joint",), "rad", time, v[:, None]) for n, v in values.items()}
        return Recording(kind, parts, {"kp": f"{gain:g}"} if gain != 1.0 else {})

    (run,), _, _ = runs_of([channels(np.zeros(len(time)))], bench)
    true = replay(law, replace(run, gain=gain), 5e-4)
    noisy = true + rng.normal(0.0, 2e-4, len(true))
    return channels(ENCODER * np.round(noisy / ENCODER))
