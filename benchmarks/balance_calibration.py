# SPDX-License-Identifier: Apache-2.0
"""A humanoid calibrated on whole-body recordings of a robot in another engine: seconds, and how near it comes to the robot.

The robot is a stand-in in DART with hidden masses, servos and contacts; three repeats of one motion are fitted, a fourth
repeat and another motion are not. Ways beside each other: CMA-ES on whole runs with the paper's 30 parameters and with more,
least squares in windows (`trueup.loop.calibrate`, 'gradient'), and least squares from where CMA-ES ended.
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import replace
from typing import Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from numpy.typing import NDArray
from results import result

from trueup.ends import End
from trueup.loop.calibrate import Options, calibrate
from trueup.recording import Recording
from trueup.studies.balance.calibration import CHANNELS, Runs, calibrated, simulator_of
from trueup.studies.balance.robot import StandInHumanoid, led
from trueup.studies.balance.scenes import transition

Array = NDArray[np.float64]

SCENE = "sit-to-stand"
MOTION = (1.081, -1.233, 1.719, -1.413, 0.232, 0.052, 0.353)
"""What a search found in the model as it is."""
OTHER = (0.9, -1.1, 1.6, -1.2, 0.1, 0.08, 0.4)
PAPERS = {"population": 32, "generations": 50, "descents": 0}
WAYS: dict[str, dict[str, Any]] = {"CMA-ES 32 x 50": PAPERS, "CMA-ES 32 x 10, then least squares": {},
                                   "least squares alone": {"generations": 0}}  # fmt: skip
PAPER = 900.0  # s, on four cores


def recorded(number: int, motion: tuple[float, ...], repeats: int) -> tuple[list[Recording], tuple[End, ...]]:
    """What a stand-in does with a motion."""
    _, task = transition(SCENE, step=0.004)
    (planned,) = task.planned(np.array(motion))
    name = "fitted" if motion == MOTION else "other"
    runs = StandInHumanoid(SCENE, number).perform(led(replace(planned, name=name, repeats=repeats)))
    return runs, task.trials[0].ends


def in_windows(parameters: str, runs: Runs) -> Array:
    """(n,) by least squares in windows, as `trueup.calibrate` does unless told otherwise."""
    options = Options(search="gradient", channels=CHANNELS, select=False, cross_validate=False, ends=runs.ends)
    found = calibrate(simulator_of(SCENE, parameters), runs.recordings, options=options)
    return np.array([e.value for e in found.estimates])


def main() -> None:
    """Prints seconds and errors by way and stand-in, and the figures of the default."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two stand-ins, two ways")
    asked = parser.parse_args()
    found: dict[str, list[Array]] = {}
    seconds: dict[str, list[float]] = {}
    for number in (120, 121) if asked.quick else (120, 121, 122, 123):
        fitted, ends = recorded(number, MOTION, 4)
        other, _ = recorded(number, OTHER, 1)
        runs = Runs(SCENE, tuple(fitted[:3]), ends)
        unseen = [Runs(SCENE, tuple(fitted[3:]), ends), Runs(SCENE, tuple(other), ends)]
        for parameters in ("wider",) if asked.quick else ("wider", "parameters"):
            simulator = simulator_of(SCENE, parameters)
            before = np.array([u.error(simulator, simulator.parameters.nominal) for u in unseen])
            ways = {k: v for k, v in WAYS.items() if not asked.quick or k != "least squares alone"}
            for way in (*ways, *(() if asked.quick else ("windows",))):
                begun = time.perf_counter()
                values = (
                    in_windows(parameters, runs)
                    if way == "windows"
                    else calibrated([runs], parameters, **WAYS[way]).values[0]
                )
                label = f"{way}, {parameters}"
                seconds.setdefault(label, []).append(time.perf_counter() - begun)
                after = np.array([u.error(simulator, values) for u in unseen])
                found.setdefault(label, []).append(np.stack([before, after]))
                print(f"stand-in {number}, {label:46} {seconds[label][-1]:5.1f} s: fourth repeat {before[0]:.3f} -> "
                      f"{after[0]:.3f} rad, another motion {before[1]:.3f} -> {after[1]:.3f} rad", flush=True)  # fmt: skip
    left = {}
    for label, rows in found.items():
        before, after = np.sqrt(np.mean(np.square(rows), axis=0))
        left[label] = after / before
        print(f"{label:46} {np.mean(seconds[label]):5.1f} s: {left[label][0]:.2f} of the error before, on another motion "
              f"{left[label][1]:.2f}")  # fmt: skip
    default, papers = "CMA-ES 32 x 10, then least squares, wider", "CMA-ES 32 x 50, wider"
    result("whole_body_calibration_seconds", float(np.mean(seconds[papers])), "s", 60.0, peer="the paper, four cores",
           peer_value=PAPER)  # fmt: skip
    result("orientation_error_left", float(left[default][0]), "of before", 0.3, peer="CMA-ES alone",
           peer_value=float(left[papers][0]))  # fmt: skip


if __name__ == "__main__":
    main()
