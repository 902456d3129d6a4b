# SPDX-License-Identifier: Apache-2.0
"""Calibrates a real 1:10 car on all tracked drives but one and predicts that one, 1 s and 3 s ahead; each in turn.

Needs the recordings (folder `jetracer` of TRUEUP_DATA, or of ../shared/data); without them it says so and ends. A prediction
starts every 0.25 s while the car drives, from what was measured until then, and goes on with the recorded throttle and
steering alone (see trueup.engines.vehicle.prediction). Beside it two plain fits of four numbers (steering delay, gain, offset
and speed scale) in a kinematic bicycle that is told the measured wheel speed of the seconds that it predicts.
"""

from __future__ import annotations

import argparse
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from results import result
from scipy.optimize import least_squares

from trueup import formats
from trueup.engines.vehicle import VehicleSimulator
from trueup.engines.vehicle.prediction import prediction_errors
from trueup.loop.prepare import prepare
from trueup.recording import Recording
from trueup.tracking.past import Past, begun_at
from trueup.trial import Trial

Array = NDArray[np.float64]

CAR = "[vehicle]\nname = 'jetracer'\nwheelbase = 0.1735\n"
HORIZONS = (1.0, 3.0)
_WHEELBASE = 0.1735


def drives(root: Path) -> list[Recording]:
    """All recordings below a folder that have a tracked position, each named after its folder and file."""
    found = []
    for file in sorted(root.rglob("*.csv")):
        (recording,) = formats.read(file)
        if recording.has("position"):
            found.append(recording.replace(name=f"{file.parent.name[:2]} {file.stem[-12:]}"))
    if len(found) < 2:
        sys.exit(f"jetracer: {len(found)} drives with a tracked position in {root}; two are needed")
    return found


def calibrated_errors(car: Path, drives: list[Recording], left_out: int) -> tuple[Array, float]:
    """(S, 2) prediction errors in m on the drive left out, and CPU seconds of the calibration on the others."""
    training = [d for k, d in enumerate(drives) if k != left_out]
    began = time.process_time()
    ready = prepare(car, training)
    simulator, found = ready.simulator, ready.calibrate()
    assert isinstance(simulator, VehicleSimulator)
    spent = time.process_time() - began
    return prediction_errors(simulator, found.values, simulator.prepared(drives[left_out]), HORIZONS), spent


class Plain:
    """Kinematic bicycle on one drive: yaw rate = v tan(gain z(t - delay) + offset) / wheelbase, v = scale * wheel speed."""

    def __init__(self, simulator: VehicleSimulator, recording: Recording) -> None:
        clean = simulator.prepared(recording)
        trial = Trial.of(clean, simulator.observable(clean))
        drive = Past.of(trial, 0.01, ("throttle", "steering"))
        self.starts = begun_at(drive, max(HORIZONS), 0.25)
        self._seen, self._steering = drive.seen, drive.commands[:, 1]
        grid = drive.begin + 0.01 * np.arange(len(drive.seen), dtype=np.float64)
        speed = clean.channel("speed")
        self._speed = np.interp(grid, speed.time, speed.values[:, 0])
        self.truth = np.stack([drive.at(grid[self.starts] + h)[:, :2] for h in HORIZONS], axis=1)

    def error(self, values: Array) -> Array:
        """(S, 2, 2) predicted minus tracked position in m, at both horizons."""
        delay, gain, offset, scale = values
        x, y, heading = self._seen[self.starts, :3].T
        found = []
        for k in range(round(100 * max(HORIZONS))):
            if k == round(100 * HORIZONS[0]):
                found.append(np.stack([x, y], axis=1))
            v = scale * self._speed[self.starts + k]
            z = np.interp(self.starts + k - 100.0 * delay, np.arange(len(self._steering)), self._steering)
            turn = v * np.tan(np.clip(gain * z + offset, -1.2, 1.2)) / _WHEELBASE
            x, y = x + 0.01 * v * np.cos(heading + 0.005 * turn), y + 0.01 * v * np.sin(heading + 0.005 * turn)
            heading = heading + 0.01 * turn
        found.append(np.stack([x, y], axis=1))
        return np.stack(found, axis=1) - self.truth


def plain_errors(plains: list[Plain], left_out: int) -> Array:
    """(S, 2) as `calibrated_errors`, by least squares on both horizons over the other drives."""

    def residual(values: Array) -> Array:
        return np.concatenate([p.error(values).ravel() for k, p in enumerate(plains) if k != left_out])

    found = least_squares(residual, [0.1, 0.4, 0.0, 1.0], diff_step=1e-3, x_scale=[0.1, 0.4, 0.05, 0.1])
    return np.linalg.norm(plains[left_out].error(found.x), axis=2)


def show(name: str, errors: Array, more: str = "") -> None:
    """One line of a table: mean, median and rms at each horizon."""
    cells = [
        f"{np.mean(e):6.3f} {np.median(e):6.3f} {np.sqrt(np.mean(e**2)):6.3f}" for e in (errors[:, 0], errors[:, 1])
    ]
    print(f"{name:24s} {len(errors):5d}   {cells[0]}   {cells[1]}  {more}", flush=True)


def main() -> None:
    """Prints a row for each drive left out, and the means over drives as RESULT lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="leave out the first drive only")
    parser.add_argument("--data", type=Path, help="folder with drives of one car")
    options = parser.parse_args()
    root = (
        options.data
        or Path(os.environ.get("TRUEUP_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")) / "jetracer"
    )
    if not root.is_dir():
        sys.exit("jetracer: no recordings (set TRUEUP_DATA to the folder that holds 'jetracer')")
    given = drives(root)
    ours, plain = [], []
    print("left out                 starts   1 s: mean median rms    3 s: mean median rms   m")
    with tempfile.TemporaryDirectory() as folder:
        car = Path(folder) / "car.toml"
        car.write_text(CAR, encoding="utf-8")
        simulator = prepare(car, given).simulator
        assert isinstance(simulator, VehicleSimulator)
        plains = [Plain(simulator, d) for d in given]
        for k in range(1 if options.quick else len(given)):
            errors, spent = calibrated_errors(car, given, k)
            ours.append(errors)
            show(given[k].name, errors, f"{spent:.1f} s CPU")
            plain.append(plain_errors(plains, k))
            show("  plain, 4 numbers", plain[-1])
    show("all", np.concatenate(ours))
    show("  plain, 4 numbers", np.concatenate(plain))
    for j, (name, goal) in enumerate((("position_error_1s", 0.08), ("position_error_3s", 0.25))):
        mine, other = (float(np.mean([e[:, j].mean() for e in errors])) for errors in (ours, plain))
        result(name, mine, "m", goal, peer="plain fit of 4 numbers, told the wheel speed", peer_value=other)


if __name__ == "__main__":
    main()
