# SPDX-License-Identifier: Apache-2.0
"""Calibrates a real quadruped's twelve drives from short runs in the air: each for itself, or like drives of the legs tied?

Needs the recordings (folder `aliengo` of TRUEUP_DATA, or of ../shared/data); without them it says so and ends. The model
has the masses and lengths that the robot's maker gives, and servos with gains of 25 and 0.5; its base is held. Every fourth
run is left out and replayed by fits to the others: as a calibration comes, and with a parameters file in which the
drives of hips, thighs and calves share what they are (their zeros stay their own).
"""

from __future__ import annotations

import argparse
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from results import result

from trueup import formats
from trueup.calibration import pooled_rmse
from trueup.loop.calibrate import Options
from trueup.loop.prepare import prepare
from trueup.recording import Recording

FOLDS = 4
LEG = """<body name="{n}_hip" pos="{f}0.2399 {s}0.051 0">
<inertial pos="{b}0.022191 {s}0.015144 0" mass="1.993" diaginertia="0.0029 0.0049 0.0056"/>
<joint name="{n}_hip_joint" axis="1 0 0"/><body name="{n}_thigh" pos="0 {s}0.083 0">
<inertial pos="-0.0056 {t}0.0039 -0.0482" mass="0.639" diaginertia="0.00585 0.00571 0.00032"/>
<joint name="{n}_thigh_joint" axis="0 1 0"/><body name="{n}_calf" pos="0 0 -0.25">
<inertial pos="0.002 0 -0.1725" mass="0.287" diaginertia="0.00704 0.00703 0.00006"/>
<joint name="{n}_calf_joint" axis="0 1 0"/></body></body></body>"""
LEGS = {"FL": ("", "", "-"), "FR": ("", "-", "-"), "RL": ("-", "", ""), "RR": ("-", "-", "")}
PARTS = ("hip", "thigh", "calf")
SERVO = '<position name="{j}" joint="{j}" kp="25" kv="0.5"/>'
SHARED = ("kp", "kv", "friction", "armature")


def model() -> str:
    """The robot as an MJCF, with the base held."""
    bodies = "".join(LEG.format(n=n, f=f, s=s, b=b, t="" if s else "-") for n, (f, s, b) in LEGS.items())
    servos = "".join(SERVO.format(j=f"{n}_{part}_joint") for n in LEGS for part in PARTS)
    return f'<mujoco model="aliengo"><worldbody>{bodies}</worldbody><actuator>{servos}</actuator></mujoco>'


def tied() -> str:
    """A parameters file in which like drives share what they are."""
    groups = ["+".join(f"{n}_{part}_joint" for n in LEGS) for part in PARTS]
    lines = [f'[[parameter]]\nquantity = "{q}"\nof = "{g}"\n' for q in SHARED for g in groups]
    lines.append('[[parameter]]\nquantity = "friction_creep"\ntie = "all"\nnominal = 1e-3\n')
    lines.append('[[parameter]]\nquantity = "zero"\noptional = "servo zero"\n')
    lines.append('[[parameter]]\nquantity = "delay"\ntie = "all"\n')
    return "\n".join(lines)


def runs() -> list[Recording]:
    """All runs; ends the program with a reason if they are absent."""
    root = Path(os.environ.get("TRUEUP_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
    files = sorted((root / "aliengo").glob("*.csv"))
    if not files:
        sys.exit("aliengo: no recordings (set TRUEUP_DATA to the folder that holds 'aliengo')")
    return [formats.read(file)[0].replace(name=file.stem) for file in files]


def held_out_error(folder: Path, recordings: Sequence[Recording], fold: int, parameters: Path | None) -> float:
    """Pooled root mean square error in rad on the runs left out."""
    held_out = recordings[fold::FOLDS]
    training = [r for k, r in enumerate(recordings) if k % FOLDS != fold]
    ready = prepare(folder / "aliengo.xml", training, held_out, parameters=parameters)
    found = ready.calibrate(Options(cross_validate=False))
    before, after = (pooled_rmse(found.held_out(), after=a) for a in (False, True))
    print(f"fold {fold}, {'tied' if parameters else 'as it comes'}: {1e3 * after:.2f} mrad left out, {1e3 * before:.1f} as "
          f"declared, {found.cpu_seconds:.0f} CPU s", flush=True)  # fmt: skip
    return after


def main() -> None:
    """Prints the RESULT line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="the first quarter of the runs left out only")
    folds = range(1 if parser.parse_args().quick else FOLDS)
    recordings = runs()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "aliengo.xml").write_text(model())
        (folder / "tied.toml").write_text(tied())
        errors = np.array([
            [held_out_error(folder, recordings, fold, file) for file in (None, folder / "tied.toml")] for fold in folds
        ])  # fmt: skip
    own, shared = np.sqrt(np.mean(errors**2, axis=0)).tolist()
    result("held_out_rmse_over_tied", own, "rad", 1.0, peer="like drives tied", peer_value=shared, ratio_goal=True)


if __name__ == "__main__":
    main()
