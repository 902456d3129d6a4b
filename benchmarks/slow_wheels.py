# SPDX-License-Identifier: Apache-2.0
"""Cars whose wheel turns slowly, late or both: where drives of 25 s lead, and how far predictions of others go astray.

A slow wheel on a short drive looks like soft tyres or a lag. Beside the calibration stands the same one with the limit of
the wheel's speed left where searches begin: what finding it earns.
"""

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import argparse
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from results import result

from trueup.calibration import Estimate
from trueup.engines.vehicle import VehicleSimulator
from trueup.engines.vehicle.prediction import prediction_errors
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]

WHEELBASE, _SPEED, _ANGLE, _STEP = 0.2, 1.2, 0.4, 0.02  # m, m/s, rad for a command of one, s


def asked(first: float, last: float) -> Array:
    """(n,) steering shares from `first` to `last` s of one long drive: gentle, quick, to either side."""
    time = np.arange(first, last, _STEP)
    return 0.6 * np.sign(np.sin(0.9 * time)) * np.abs(np.sin(0.23 * time))


def turned(steering: Array, rate: float, late: float, rng: np.random.Generator | None = None) -> Recording:
    """A drive at a steady speed whose wheel follows `steering` (n,) so many s late and at most at `rate` (1/s)."""
    wheel, reached = np.zeros(len(steering)), 0.0
    for k in range(len(steering)):
        wanted = steering[max(k - round(late / _STEP), 0)]
        reached += float(np.clip(wanted - reached, -_STEP * rate, _STEP * rate))
        wheel[k] = reached
    heading = np.concatenate([[0.0], np.cumsum(_SPEED * np.tan(_ANGLE * wheel) / WHEELBASE * _STEP)])
    middle = (heading[:-1] + heading[1:]) / 2.0
    way = np.cumsum(_SPEED * _STEP * np.stack([np.cos(middle), np.sin(middle)], axis=1), axis=0)
    place, heading = np.concatenate([np.zeros((1, 2)), way[:-1]]), heading[:-1, None]
    if rng is not None:
        place, heading = place + rng.normal(0.0, 5e-4, place.shape), heading + rng.normal(0.0, 1e-3, heading.shape)
    time = np.linspace(0.0, _STEP * (len(steering) - 1), len(steering))
    return Recording("turned", {
        "command": Channel("command", ("throttle", "steering"), "", time, np.stack([0 * steering + 0.3, steering], axis=1)),
        "position": Channel("position", ("x", "y"), "m", time, place),
        "heading": Channel("heading", ("heading",), "rad", time, heading),
    })  # fmt: skip


def _judged(car: Path, first: float, rate: float, late: float, *, searched: bool = True) -> tuple[Estimate, Array]:
    """The limit that was found, if it is `searched`, and errors in m of predictions 1 s and 3 s ahead of another drive."""
    other = 45.0 if first < 30.0 else 0.0
    ready = prepare(car, [turned(asked(first, first + 25.0), rate, late, np.random.default_rng(int(50 * first)))])
    ready = (
        ready if searched else ready.only([n for n in ready.simulator.parameters.names if n != "steering_rate_limit"])
    )
    found = ready.calibrate()
    assert isinstance(ready.simulator, VehicleSimulator)
    unseen = ready.simulator.prepared(turned(asked(other, other + 30.0), rate, late, np.random.default_rng(7)))
    limit = next(e for e in found.estimates if e.name == "steering_rate_limit")
    return limit, prediction_errors(ready.simulator, found.values, unseen).mean(axis=0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one drive in place of three")
    quick = parser.parse_args().quick
    cars = ((0.5, 0.0), (0.5, 0.1), (1.0, 0.1), (2.0, 0.1), (np.inf, 0.1), (np.inf, 0.25))
    print("drive from   rate    late   found   3 s ahead, mm   at start")
    every, held = [], []
    with tempfile.TemporaryDirectory() as folder:
        car = Path(folder) / "car.toml"
        car.write_text(f"[vehicle]\nwheelbase = {WHEELBASE}\n", encoding="utf-8")
        for first in (45.0,) if quick else (0.0, 20.0, 45.0):
            for rate, late in cars:
                limit, errors = _judged(car, first, rate, late)
                _, without = _judged(car, first, rate, late, searched=False)
                every.append((errors[1], without[1]))
                if limit.verdict == "identified":
                    held.append(limit.low <= rate <= limit.high)
                shown = f"{limit.value:7.2f} {1e3 * errors[1]:15.1f} {1e3 * without[1]:9.1f}"
                print(f"{first:8.0f} s {rate:6.2g} {late:7.2f} {shown}", flush=True)
    ours, theirs = np.exp(np.mean(np.log(every), axis=0)).tolist()
    said = "with the limit left at its start value"
    result("slow_wheels_3s", ours, "m", 1.0, peer=said, peer_value=theirs, ratio_goal=True)
    worst, peers_worst = np.max(every, axis=0).tolist()
    result("slow_wheels_3s_at_worst", worst, "m", 1.0, peer=said, peer_value=peers_worst, ratio_goal=True)
    share = float(np.mean(held)) if held else float("nan")
    result("slow_wheels_coverage", share, f"of {len(held)} called identified", 0.9, at_most=False)


if __name__ == "__main__":
    main()
