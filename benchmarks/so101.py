# SPDX-License-Identifier: Apache-2.0
"""Calibrates a real SO-101 arm from recordings and replays motions held out, beside mujoco.sysid and the shipped model.

Needs the recordings (folder `so101` of TRUEUP_DATA, or of ../shared/data); without them it says so and ends.

`--leave-one-out FOLDER` fits without one recording in turn (`--folds NAME ...`: these alone), as it comes and without limits
of the commands' speed and acceleration, and pools the errors on what was left out. Each fit is kept in FOLDER as soon as it
is there, so that the command goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import json
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from results import result

from trueup import formats
from trueup.articulated.hidden_limits import LIMITS
from trueup.calibration import Calibration, TracePoint, pooled_rmse
from trueup.engines.simulator import Respaced
from trueup.loop.calibrate import Options
from trueup.loop.prepare import prepare
from trueup.recording import Recording

Array = NDArray[np.float64]

TRAINING = ("multisine", "chirp_sweep", "step_response", "friction_gravity", "backlash_detection", "random_waypoints")
HELD_OUT = ("fast_transitions", "hold_under_gravity", "square_pattern", "sinusoidal_sweep")
JOINTS = {
    "Rotation": "shoulder_pan", "Pitch": "shoulder_lift", "Elbow": "elbow_flex", "Wrist_Pitch": "wrist_flex",
    "Wrist_Roll": "wrist_roll",
}  # fmt: skip


def folder() -> Path:
    """Where the recordings lie; ends the program with a reason if they are absent."""
    root = Path(os.environ.get("TRUEUP_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
    if not (root / "so101").is_dir():
        sys.exit("so101: no recordings (set TRUEUP_DATA to the folder that holds 'so101')")
    return root / "so101"


def recordings(names: Sequence[str], cut: float | None = None) -> list[Recording]:
    """Commands and positions of the five arm joints, by the model's names; the first `cut` s of each."""
    found = []
    for name in names:
        recording = formats.read(folder() / "recordings" / name)[0].replace(name=name).rename(JOINTS)
        for role in [c for c in recording.channels if c not in ("command", "position")]:
            recording = recording.without(role)
        for role in ("command", "position"):
            recording = recording.with_channel(recording.channel(role).select(tuple(JOINTS.values())))
        found.append(recording if cut is None else recording.slice(recording.start, recording.start + cut))
    return found


def fit(training: Sequence[Recording], held_out: Sequence[Recording]) -> Calibration:
    """Our calibration with what trueup proposes by itself."""
    return prepare(folder() / "model" / "so101_new_calib.xml", training, held_out).calibrate(progress=_progress)


def left_out(name: str, limits: bool) -> dict[str, Any]:
    """Squared error in rad^2 summed over the recording `name` by a fit to the other ones, its samples, seconds, words."""
    ready = prepare(
        folder() / "model" / "so101_new_calib.xml", recordings([n for n in TRAINING if n != name]), recordings([name])
    )
    space = ready.simulator.parameters
    absent = [p.name for p in space.parameters if p.optional in LIMITS]
    if not limits and isinstance(ready.simulator, Respaced):
        ready = replace(ready, simulator=ready.simulator.with_parameters(space.without(absent)))
    found = ready.calibrate(Options(cross_validate=False), progress=_progress)
    print()
    errors = np.concatenate([r.after - r.measured for r in found.held_out()])
    rows = [f"{e.name} {e.value:.4g} [{e.low:.4g}, {e.high:.4g}] {e.verdict} {e.note}" for e in found.estimates]
    kept = [e.name for e in found.estimates if e.fitted and e.name in absent]
    return {"squares": float(np.nansum(errors**2)), "samples": int(np.isfinite(errors).sum()), "limits": kept,
            "cpu": found.cpu_seconds, "notes": [*rows, *found.notes, *found.unidentified]}  # fmt: skip


def leave_one_out(names: Sequence[str], kept: Path) -> None:
    """Prints the error on each recording by fits to the others, and the RESULT line."""
    kept.mkdir(parents=True, exist_ok=True)
    squares, samples = np.zeros(2), 0
    for name in names:
        fits = []
        for limits in (True, False):
            file = kept / f"{name}{'' if limits else '_without_limits'}.json"
            if not limits and not fits[0]["limits"]:
                fits.append(fits[0])  # as it comes it has none either
                continue
            if not file.exists():
                file.write_text(json.dumps(left_out(name, limits), indent=1))
            fits.append(json.loads(file.read_text()))
        own = np.array([f["squares"] for f in fits])
        squares, samples = squares + own, samples + fits[0]["samples"]
        error = 1e3 * np.sqrt(own / fits[0]["samples"])
        print(f"{name:20s} left out: {error[0]:6.2f} mrad, {fits[0]['cpu']:.0f} CPU s; without limits {error[1]:6.2f} mrad, "
              f"{fits[1]['cpu']:.0f} CPU s", flush=True)  # fmt: skip
    pooled = np.sqrt(squares / samples)
    result("leave_one_out_over_without_limits", float(pooled[0]), "rad", 0.6, peer="trueup without limits of commands",
           peer_value=float(pooled[1]), ratio_goal=True)  # fmt: skip


def _progress(point: TracePoint) -> None:
    print(f"\r  {point.stage:20s} {1e3 * point.rmse:7.2f} mrad  {point.seconds:6.1f} s", end="", flush=True)


def peer(training: Sequence[Recording], held_out: Sequence[Recording], most: int) -> tuple[float, float]:
    """Pooled held-out error [rad] and CPU seconds of mujoco.sysid with kp, damping, friction and armature of each joint."""
    import peer_sysid
    from peer_sysid import PeerParameter

    bounds = {"actuator.kp": (998.22, 10.0, 2000.0), "joint.damping": (0.6, 0.01, 30.0),
              "joint.friction": (0.052, 0.001, 2.0), "joint.armature": (0.028, 0.001, 0.3)}  # fmt: skip
    rows = [PeerParameter(q, j, *b) for q, b in bounds.items() for j in JOINTS.values()]
    path = folder() / "model" / "so101_new_calib.xml"
    theirs = peer_sysid.fit(path, rows, [_whole(r) for r in training], geoms="none", x_scale="jac", max_iters=most)
    errors = []
    for recording in held_out:
        simulated = theirs.replay(_whole(recording))["position"][:, : len(JOINTS)]
        errors.append((simulated - recording.channel("position").values).ravel())
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2))), theirs.cpu_seconds


def _whole(recording: Recording) -> Recording:
    """With the jaw, which the peer wants commanded: it stays where it is."""
    command = recording.channel("command")
    still = np.zeros((len(command.time), 1))
    return recording.with_channel(
        command.replace(labels=(*command.labels, "gripper"), values=np.hstack([command.values, still]))
    )


def main() -> None:
    """Prints the table and the RESULT lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="15 s of three recordings, no peer")
    parser.add_argument("--no-peer", action="store_true")
    parser.add_argument("--peer-iterations", type=int, default=8)
    parser.add_argument("--leave-one-out", type=Path, metavar="FOLDER")
    parser.add_argument("--folds", nargs="+", default=TRAINING, choices=TRAINING, metavar="NAME")
    options = parser.parse_args()
    if options.leave_one_out is not None:
        leave_one_out(options.folds, options.leave_one_out)
        return
    training = recordings(TRAINING[2:5] if options.quick else TRAINING, 15.0 if options.quick else None)
    held_out = recordings(HELD_OUT)
    began = time.perf_counter()
    found = fit(training, held_out)
    print(f"\n{len(found.estimates)} parameters, {time.perf_counter() - began:.0f} s, {found.cpu_seconds:.0f} CPU s\n")
    print("recording             shipped  calibrated  ratio   [mrad, five joints pooled]")
    for replay in found.replays:
        before, after = pooled_rmse([replay], after=False), pooled_rmse([replay], after=True)
        print(f"{replay.recording:20s} {1e3 * before:8.2f} {1e3 * after:11.2f} {after / before:6.2f}"
              f"{'   held out' if replay.held_out else ''}")  # fmt: skip
    before, after = pooled_rmse(found.held_out(), after=False), pooled_rmse(found.held_out(), after=True)
    worst = max(pooled_rmse([r], after=True) / pooled_rmse([r], after=False) for r in found.held_out())
    result("held_out_rmse_over_shipped", after, "rad", 0.45, peer="shipped model", peer_value=before, ratio_goal=True)
    result("worst_held_out_motion_over_shipped", worst, "", 1.0)
    if not (options.quick or options.no_peer):
        error, cpu = peer(training, held_out, options.peer_iterations)
        result("held_out_rmse_over_sysid", after, "rad", 1.0, peer=f"mujoco.sysid, {options.peer_iterations} iterations",
               peer_value=error, ratio_goal=True)  # fmt: skip
        result("cpu_seconds", found.cpu_seconds, "s", 1.0, peer=f"mujoco.sysid, {options.peer_iterations} iterations",
               peer_value=cpu, ratio_goal=True)  # fmt: skip


if __name__ == "__main__":
    main()
