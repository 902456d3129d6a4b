# SPDX-License-Identifier: Apache-2.0
"""The demonstration: a simulated arm with a hidden truth of another structure is recorded, calibrated and reported."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from importlib import resources
from pathlib import Path

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Calibration, TracePoint, pooled_rmse
from trueup.errors import OutputError
from trueup.formats import read
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording
from trueup.report import write_report
from trueup.robots.stand_in import StandInArm
from trueup.trial import Observed, Trial

RATE = 50.0  # Hz
HELD_OUT = ("sinusoids", "pick_and_place")


def run(folder: Path, say: Callable[[str], None], progress: Callable[[TracePoint], None] | None = None) -> Calibration:
    """Performs trials on the stand-in arm, calibrates its model with them and writes recordings and report to `folder`.

    `say` is given one line at each step. Raises OutputError where the folder cannot be written.
    """
    folder = Path(folder)
    record(folder / "recordings")
    # From here on the stand-in is a stranger: all that is known of it are these files.
    recordings = read(sorted((folder / "recordings").glob("*.csv")))
    training = [r for r in recordings if r.name not in HELD_OUT]
    held_out = [r for r in recordings if r.name in HELD_OUT]
    seconds = sum(r.duration for r in training)
    say(f"recorded a stand-in arm: {len(training)} motions, {seconds:.0f} s in all, and {len(held_out)} more held out")
    ready = prepare(model_path(), training, held_out)
    say(f"calibrating {int(ready.simulator.parameters.free.sum())} parameters of {model_path().name}")
    calibration = ready.calibrate(progress=progress)
    for name, replays in (("fitted motions", calibration.training()), ("held out", calibration.held_out())):
        before, after = pooled_rmse(replays, after=False), pooled_rmse(replays, after=True)
        say(f"{name}: replay error {1e3 * before:.1f} -> {1e3 * after:.1f} mrad")
    report = write_report(calibration, folder / "report.html", title="A stand-in arm, calibrated")
    say(f"wrote {report}")
    return calibration


def model_path() -> Path:
    """The arm's MJCF, as its maker would ship it."""
    return Path(str(resources.files("trueup") / "studies" / "servo_arm" / "arm.xml"))


def record(folder: Path) -> list[Path]:
    """Performs the demonstration's motions on the stand-in arm; one CSV each. Raises OutputError on a bad disk."""
    arm = StandInArm(model_path())
    paths = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, command in motions(len(arm.joints)).items():
            time = np.arange(len(command), dtype=np.float64) / RATE
            trial = Trial(
                name=name, start=0.0, duration=float(time[-1]),
                command=Channel("command", arm.joints, "rad", time, command),
                observed={"position": Observed(arm.joints, "rad", time)},
            )  # fmt: skip
            paths.append(folder / f"{name}.csv")
            _write_csv(arm.perform(trial)[0], paths[-1])
    except OSError as error:
        raise OutputError(f"cannot write recordings to '{folder}': {error.strerror or error}") from error
    return paths


def motions(joints: int) -> Mapping[str, Array]:
    """Name to commanded angles (T, joints) in rad, at RATE: four motions to learn from and two to be judged on."""
    rng = np.random.default_rng(7)
    reach = np.array([0.9, 0.8, 0.9, 0.9])[:joints]
    return {
        "multisine": reach * _multisine(rng, 12.0, joints, (0.1, 1.6)),
        "steps": reach * _steps(rng, 10.0, joints, every=1.0),
        "slow_ramps": reach * _ramps(12.0, joints),
        "waypoints": reach * _waypoints(rng, 12.0, joints, every=1.2),
        HELD_OUT[0]: 0.9 * reach * _sinusoids(10.0, joints),
        HELD_OUT[1]: reach * _waypoints(rng, 11.0, joints, every=0.8),
    }


def _clock(duration: float) -> Array:
    return np.arange(round(duration * RATE) + 1) / RATE


def _multisine(rng: np.random.Generator, duration: float, joints: int, band: tuple[float, float]) -> Array:
    """Six sines with amplitudes falling with frequency, faded in and out, within [-1, 1]."""
    time = _clock(duration)[:, None, None]
    frequency = np.geomspace(*band, 6)[:, None] * rng.uniform(0.9, 1.1, (6, joints))
    phase = rng.uniform(0, 2 * np.pi, (6, joints))
    motion = (np.sin(2 * np.pi * frequency * time + phase) / frequency**0.7).sum(axis=1)
    fade = np.clip(np.minimum(time[:, 0], duration - time[:, 0]) / 0.7, 0.0, 1.0)
    return motion / np.abs(motion).max(axis=0) * fade


def _steps(rng: np.random.Generator, duration: float, joints: int, every: float) -> Array:
    """Jumps of one joint after the other, held for a while."""
    time = _clock(duration)
    motion = np.zeros((len(time), joints))
    for k in range(1, int(duration / every)):
        motion[time >= k * every, k % joints] = rng.uniform(0.3, 0.8) * (-1) ** (k // joints + k)
    return motion


def _ramps(duration: float, joints: int) -> Array:
    """Slow triangles with many reversals, of growing amplitude."""
    time = _clock(duration)[:, None]
    period = 3.0 + 0.7 * np.arange(joints)
    triangle = 2.0 / np.pi * np.arcsin(np.sin(2 * np.pi * time / period))
    return triangle * (0.15 + 0.5 * time / duration)


def _waypoints(rng: np.random.Generator, duration: float, joints: int, every: float) -> Array:
    """Random poses, reached by smooth curves and held for a moment."""
    time = _clock(duration)
    poses = np.concatenate([np.zeros((1, joints)), rng.uniform(-0.9, 0.9, (int(duration / every) + 2, joints))])
    which = np.minimum((time / every).astype(int), len(poses) - 2)
    s = np.clip((time / every - which) / 0.7, 0.0, 1.0)[:, None]
    return poses[which] + (10 * s**3 - 15 * s**4 + 6 * s**5) * (poses[which + 1] - poses[which])


def _sinusoids(duration: float, joints: int) -> Array:
    """One sine a joint, all of different pace."""
    time = _clock(duration)[:, None]
    return np.sin(2 * np.pi * (0.35 + 0.12 * np.arange(joints)) * time)


def _write_csv(recording: Recording, path: Path) -> None:
    command, position = recording.channel("command"), recording.channel("position")
    with path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["time_s", *(f"cmd_{x}" for x in command.labels), *(f"pos_{x}" for x in position.labels)])
        for t, asked, measured in zip(position.time, command.values, position.values, strict=True):
            rows.writerow([f"{t:.4f}", *(f"{v:.6f}" for v in (*asked, *measured))])
