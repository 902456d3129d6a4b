# SPDX-License-Identifier: Apache-2.0
"""Calibrates drawn arms on servos that were logged with encoders and an inertial board that tells late or early.

Two joints, a gyro and an accelerometer on the last link. The board's clock is 8 ms early to 12 ms late, and half of the
boards smooth over 3 to 10 ms, which is late too. The robot is simulated at half a millisecond. Beside it the same calibration
with every board taken to be on time.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import mujoco
import numpy as np
from results import result
from scipy.signal import lfilter

from trueup.arrays import Array
from trueup.loop.calibrate import Options
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording

_STEP = 5e-4  # s, of the robot
_SECONDS = 8.0
_NOISE = 3e-4  # rad, of encoders
_SENSED = {"rates": ("rad/s", 0.01), "forces": ("m/s^2", 0.1)}
KINDS = {"kp": (30.0, 90.0, 60.0), "friction": (0.05, 0.3, 0.1), "armature": (0.008, 0.03, 0.015)}
"""Between which numbers true drives are, and what the file says."""
DELAY = "sensor_delay"


@dataclass(frozen=True)
class Arm:
    """An arm, its board, and how late its servos follow commands."""

    drives: dict[str, Array]
    """Kind to (2,)."""
    late: float
    smoothed: float
    delay: float

    @classmethod
    def drawn(cls, number: int) -> Arm:
        """Arm `number`."""
        rng = np.random.default_rng(700 + number)
        drives = {kind: rng.uniform(low, high, 2) * (1.0, 0.6) for kind, (low, high, _) in KINDS.items()}
        smoothed = rng.uniform(0.003, 0.01) if number % 2 else 0.0
        return cls(drives, float(rng.uniform(-0.008, 0.012)), smoothed, float(rng.uniform(0.0, 0.02)))

    @staticmethod
    def mjcf(drives: dict[str, Array]) -> str:
        """With these drives."""
        joints = [
            f'<joint name="{name}" axis="0 1 0" damping=".2" frictionloss="{drives["friction"][k]}" '
            f'armature="{drives["armature"][k]}"/>' for k, name in enumerate(("lift", "bend"))
        ]  # fmt: skip
        servos = "".join(
            f'<position joint="{name}" kp="{drives["kp"][k]}" kv="1"/>' for k, name in enumerate(("lift", "bend"))
        )
        return f"""<mujoco><compiler angle="radian"/><option timestep="0.002"/><worldbody>
        <body>{joints[0]}<geom type="capsule" size=".03" fromto="0 0 0 .25 0 -.1" mass="1" contype="0" conaffinity="0"/>
        <body pos=".25 0 -.1">{joints[1]}<geom type="capsule" size=".02" fromto="0 0 0 .2 0 0" mass=".4" contype="0"
        conaffinity="0"/><site name="board" pos=".15 0 .02"/></body></body></worldbody><actuator>{servos}</actuator>
        <sensor><gyro name="rates" site="board"/><accelerometer name="forces" site="board"/></sensor></mujoco>"""

    def log(self, name: str, seed: int) -> Recording:
        """Commands and encoders at 100 Hz, the board at 200 Hz."""
        model, rng = mujoco.MjModel.from_xml_string(self.mjcf(self.drives)), np.random.default_rng(seed)
        model.opt.timestep = _STEP
        data, clock = mujoco.MjData(model), _STEP * np.arange(round(_SECONDS / _STEP), dtype=np.float64)
        when = 0.01 * np.arange(round(100 * _SECONDS), dtype=np.float64)
        pace, phase = rng.uniform(1.0, 12.0, (2, 4)), rng.uniform(0.0, 6.0, (2, 4))
        told = 0.12 * np.sum(np.sin(pace * when[:, None, None] + phase), axis=2) * np.minimum(1.0, when)[:, None]
        rows = np.searchsorted(when, clock - self.delay, side="right") - 1
        seen = []
        for row in rows.clip(0):
            data.ctrl[:] = told[row]
            mujoco.mj_step(model, data)
            seen.append([*data.qpos, *data.sensordata])
        moved = np.array(seen)
        if self.smoothed:
            kept = np.exp(-_STEP / self.smoothed)
            moved[:, 2:] = lfilter([1.0 - kept], [1.0, -kept], moved[:, 2:], axis=0)
        asked = 0.0133 + 0.005 * np.arange(round(200 * _SECONDS) - 6, dtype=np.float64)
        at = [np.interp(asked - self.late, clock, column) for column in moved.T[2:]]
        board = {"rates": np.stack(at[:3], axis=1), "forces": np.stack(at[3:], axis=1)}
        angles = np.stack([np.interp(when, clock, column) for column in moved.T[:2]], axis=1)
        channels = {
            "command": Channel("command", ("lift", "bend"), "rad", when, told),
            "position": Channel(
                "position", ("lift", "bend"), "rad", when, angles + rng.normal(0.0, _NOISE, angles.shape)
            ),
        }
        for sensor, (unit, noise) in _SENSED.items():
            values = board[sensor] + rng.normal(0.0, noise, board[sensor].shape)
            labels = tuple(f"{sensor}.{axis}" for axis in "xyz")
            channels[sensor] = Channel(sensor, labels, unit, asked, values)
        return Recording(name, channels)


@dataclass(frozen=True)
class Found:
    """Held-out error of encoders and gyro, CPU seconds, and how much is called identified and holds."""

    encoders: float
    gyro: float
    cpu: float
    claims: int
    held: int


def calibrated(folder: Path, number: int, *, on_time: bool) -> Found:
    """Arm `number`, from two logs, judged on a third; with its board taken to be `on_time`, or asked how late it is."""
    arm, file = Arm.drawn(number), folder / f"arm{number}.xml"
    file.write_text(arm.mjcf({kind: np.array([start, 0.6 * start]) for kind, (*_, start) in KINDS.items()}))
    began = time.process_time()
    ready = prepare(file, [arm.log(f"r{k}", 10 * number + k) for k in (1, 2)], [arm.log("judged", 10 * number + 3)])
    if on_time:
        ready = ready.only([p.name for p in ready.simulator.parameters.parameters if DELAY not in p.name])
    done = ready.calibrate(Options(cross_validate=False))
    cpu = time.process_time() - began
    off = {r.channel: float(np.sqrt(np.nanmean((r.after - r.measured) ** 2))) for r in done.replays if r.held_out}
    truth = {f"{j}.{kind}": float(arm.drives[kind][k]) for k, j in enumerate(("lift", "bend")) for kind in KINDS}
    truth["delay"] = arm.delay
    claims = [e for e in done.estimates if e.name in truth and e.verdict == "identified"]
    held = sum(e.low <= truth[e.name] <= e.high for e in claims)
    return Found(off["position"], off["rates"], cpu, len(claims), held)


def main() -> None:
    """Prints a line for each arm and the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two arms")
    parser.add_argument("--arms", type=int, default=8)
    options = parser.parse_args()
    asked, plain = [], []
    print("held out: encoders, mrad; gyro, mrad/s; CPU s; held    with the board asked, and on time", flush=True)
    with tempfile.TemporaryDirectory() as name:
        for number in range(2 if options.quick else options.arms):
            arm = Arm.drawn(number)
            asked.append(calibrated(Path(name), number, on_time=False))
            plain.append(calibrated(Path(name), number, on_time=True))
            late = f"{1e3 * arm.late:+.1f} ms, smoothed {1e3 * arm.smoothed:.1f} ms"
            print(f"arm {number} ({late})" + "".join(
                f"   {1e3 * f.encoders:6.3f} {1e3 * f.gyro:6.1f} {f.cpu:5.1f} s {f.held:2d} of {f.claims:2d}"
                for f in (asked[-1], plain[-1])), flush=True)  # fmt: skip
    a, b = (np.array([[f.encoders, f.gyro, f.cpu] for f in found]) for found in (asked, plain))
    peer = "every board on time"
    for k, (what, unit) in enumerate((("encoders", "rad, geometric mean"), ("gyro", "rad/s, geometric mean"))):
        mean = [float(np.exp(np.mean(np.log(x[:, k])))) for x in (a, b)]
        result(f"late_boards_{what}", mean[0], unit, 1.0, ratio_goal=True, peer=peer, peer_value=mean[1])
    result("late_boards_cpu_seconds", float(a[:, 2].sum()), "s", 1.5, ratio_goal=True, peer=peer,
           peer_value=float(b[:, 2].sum()))  # fmt: skip
    shares = [sum(f.held for f in found) / max(sum(f.claims for f in found), 1) for found in (asked, plain)]
    result("late_boards_coverage", shares[0], f"of {sum(f.claims for f in asked)}", 0.9, at_most=False, peer=peer,
           peer_value=shares[1])  # fmt: skip


if __name__ == "__main__":
    main()
