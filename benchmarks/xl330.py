# SPDX-License-Identifier: Apache-2.0
"""Calibrates a real Dynamixel XL330 with a pendulum at two of its gains and replays the third; each gain in turn.

Needs the recordings (folder `xl330_pendulum` of TRUEUP_DATA, or of ../shared/data); without them it says so and ends. The
model is what the rig's description says: 0.49 kg at 0.1 m, a position servo. Once with the parameters that are proposed, all
part of MJCF, and once with friction that grows with the load (`trueup calibrate --beyond-mjcf`). The peer's figure is cited:
the parameters that the project BAM (Duclusaud et al. 2024) fitted itself replay these logs with a mean absolute error of 55.7
to 59.9 mrad, over all of them and with the stretches in which the servo was off, which are cut here.
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

from trueup import formats
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
    """All recordings while the servo was on; ends the program with a reason if they are absent."""
    root = Path(os.environ.get("TRUEUP_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
    files = sorted((root / "xl330_pendulum").glob("*.json"))
    if not files:
        sys.exit("xl330: no recordings (set TRUEUP_DATA to the folder that holds 'xl330_pendulum')")
    return while_driven([r for file in files for r in formats.read(file)])[0]


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


def main() -> None:
    """Prints RESULT lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one gain held out only")
    quick = parser.parse_args().quick
    recordings = logs()
    with tempfile.TemporaryDirectory() as name:
        for title, beyond in (("held_out_mae", False), ("held_out_mae_with_load", True)):
            errors: list[float] = []
            seconds = 0.0
            for gain in GAINS[1:2] if quick else GAINS:
                each, took = held_out_errors(Path(name), recordings, gain, beyond)
                print(f"{title}, gain {gain}: " + " ".join(f"{e:.1f}" for e in each) + f" mrad, {took:.1f} CPU s")
                errors += each
                seconds += took
            result(title, float(np.mean(errors)), "mrad", 1.0, peer="BAM, cited", peer_value=BAM, ratio_goal=True)
            result(title.replace("held_out_mae", "cpu_seconds"), seconds, "s", 120.0)


if __name__ == "__main__":
    main()
