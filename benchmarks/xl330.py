# SPDX-License-Identifier: Apache-2.0
"""Calibrates a real Dynamixel XL330 with a pendulum at two of its gains and replays the third; each gain in turn.

Needs the recordings (folder `xl330_pendulum` of TRUEUP_DATA, or of ../shared/data); without them it says so and ends. The
model is what the rig's description says: 0.49 kg at 0.1 m, a position servo. Once with the parameters that are proposed, all
part of MJCF, and once with friction that grows with the load (`trueup calibrate --beyond-mjcf`). The peer's figure is cited:
the parameters that the project BAM (Duclusaud et al. 2024) fitted itself replay these logs with a mean absolute error of 55.7
to 59.9 mrad, over all of them and with the stretches in which the servo was off, which are cut here.

And by `trueup identify-actuator` as it comes, which chooses the servo's structure itself: there whole logs are replayed, with
stretches in which the servo was off. It is told nothing beyond what the logs say (mass, length, settings of the gain).
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
from results import result
from yardstick import REPLAYS, replay_seconds

from trueup import formats
from trueup.actuators.identify import identify_actuator
from trueup.commands.sources import while_driven
from trueup.loop.calibrate import Options
from trueup.loop.prepare import prepare
from trueup.recording import Recording

PENDULUM = """<mujoco model="pendulum"><worldbody><body><joint name="joint" axis="0 1 0"/>
<inertial pos="0 0 -0.1" mass="0.49" diaginertia="2e-4 2e-4 2e-4"/></body></worldbody>
<actuator><position name="joint" joint="joint" kp="10"/></actuator></mujoco>"""
GAINS = ("100", "200", "400")
BAM = 55.7  # mrad, the best of its models


def logs() -> list[Recording]:
    """All recordings; ends the program with a reason if they are absent."""
    root = Path(os.environ.get("TRUEUP_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
    files = sorted((root / "xl330_pendulum").glob("*.json"))
    if not files:
        sys.exit("xl330: no recordings (set TRUEUP_DATA to the folder that holds 'xl330_pendulum')")
    return [r for file in files for r in formats.read(file)]


def held_out_errors(
    folder: Path, recordings: list[Recording], gain: str, beyond_mjcf: bool
) -> tuple[list[float], float]:
    """Mean absolute error in mrad on each log at `gain`, fitted at the others, and the CPU seconds of that."""
    model = folder / "pendulum.xml"
    model.write_text(PENDULUM)
    began = time.process_time()
    training = [r for r in recordings if r.provenance["kp"] != gain]
    held_out = [r for r in recordings if r.provenance["kp"] == gain]
    ready = prepare(model, training, held_out, beyond_mjcf=beyond_mjcf)
    found = ready.calibrate(Options(cross_validate=False))
    errors = [1e3 * float(np.nanmean(np.abs(r.after - r.measured))) for r in found.held_out()]
    return errors, time.process_time() - began


def identified(recordings: list[Recording], gain: str) -> tuple[list[float], list[float]]:
    """Mean absolute errors in mrad on each log at `gain`, by the law and by what MJCF can hold of it, from the others."""
    training = [r for r in recordings if r.provenance["kp"] != gain]
    held_out = [r for r in recordings if r.provenance["kp"] == gain]
    found = identify_actuator(training, held_out)
    print(f"actuator, gain {gain}: {', '.join(found.structures)}")
    judged = [j for j in found.judged if j.held_out]
    return [1e3 * j.model for j in judged], [1e3 * j.file for j in judged]


def main() -> None:
    """Prints RESULT lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one gain held out only")
    quick = parser.parse_args().quick
    whole = logs()
    recordings, gains = while_driven(whole)[0], GAINS[1:2] if quick else GAINS
    _actuator(whole, gains)
    with tempfile.TemporaryDirectory() as name:
        for title, beyond in (("held_out_mae", False), ("held_out_mae_with_load", True)):
            errors: list[float] = []
            seconds = 0.0
            for gain in gains:
                each, took = held_out_errors(Path(name), recordings, gain, beyond)
                print(f"{title}, gain {gain}: " + " ".join(f"{e:.1f}" for e in each) + f" mrad, {took:.1f} CPU s")
                errors += each
                seconds += took
            result(title, float(np.mean(errors)), "mrad", 50.0, peer="BAM, cited", peer_value=BAM)
            _cost(title.replace("held_out_mae", "cpu_seconds"), seconds, recordings, gains)


def _actuator(recordings: list[Recording], gains: tuple[str, ...]) -> None:
    began = time.process_time()
    laws, files = [], []
    for gain in gains:
        law, file = identified(recordings, gain)
        print(
            "  left out: " + " ".join(f"{e:.1f}" for e in law) + " mrad; in MJCF " + " ".join(f"{e:.1f}" for e in file)
        )
        laws += law
        files += file
    result("held_out_mae_actuator", float(np.mean(laws)), "mrad", 40.0, peer="BAM, cited", peer_value=BAM)
    result("held_out_mae_actuator_mjcf", float(np.mean(files)), "mrad", 1.0, peer="BAM, cited", peer_value=BAM,
           ratio_goal=True)  # fmt: skip
    _cost("cpu_seconds_actuator", time.process_time() - began, recordings, gains)


def _cost(name: str, seconds: float, recordings: list[Recording], gains: tuple[str, ...]) -> None:
    fitted = sum(r.duration for gain in gains for r in recordings if r.provenance["kp"] != gain)
    result(name, seconds, "s", 1.0, peer=REPLAYS, peer_value=replay_seconds(PENDULUM, fitted, 1000), ratio_goal=True)


if __name__ == "__main__":
    main()
