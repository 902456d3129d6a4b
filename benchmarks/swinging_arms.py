# SPDX-License-Identifier: Apache-2.0
"""Calibrates drawn arms that torques swing, over whole turns, from files whose drives are ordinary ones; replays another log.

One to three joints, logged at 100 to 500 Hz for 6 to 20 s with 0.1 to 1 mrad of noise; torques are sums of three sines that
come to 0.6 to 1.6 times the weight of what hangs on a joint. The robot is simulated at half a millisecond. Beside it the same
calibration with whole replays.
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

from trueup.arrays import Array
from trueup.loop.calibrate import Options
from trueup.loop.prepare import prepare
from trueup.loop.replay import replays
from trueup.recording import Channel, Recording

_AXES = ("0 1 0", "0 1 0", "1 0 0")
_FINER = np.array([1.0, 0.5, 0.2])  # of a joint's drive, by its place
_STEP = 5e-4  # s, of the robot
KINDS = {"damping": (0.02, 0.2, 0.1), "friction": (0.02, 0.2, 0.0), "armature": (0.002, 0.02, 0.01)}
"""Between which numbers true drives are, and what the file says."""


@dataclass(frozen=True)
class Arm:
    """An arm and how it is logged."""

    masses: Array
    lengths: Array
    drives: dict[str, Array]
    """Kind to (n,)."""
    rate: float
    noise: float
    seconds: float
    share: float
    """Of the weight that hangs on a joint, which torques come to."""

    @classmethod
    def drawn(cls, number: int) -> Arm:
        """Arm `number`."""
        rng = np.random.default_rng(900 + number)
        n = int(rng.integers(1, 4))
        masses, lengths = rng.uniform(0.5, 2.0, n) * (1.0, 0.6, 0.4)[:n], rng.uniform(0.2, 0.4, n)
        drives = {kind: rng.uniform(low, high, n) * _FINER[:n] for kind, (low, high, _) in KINDS.items()}
        rate, noise, seconds = (
            float(rng.choice(x)) for x in ([100.0, 200.0, 500.0], [1e-4, 3e-4, 1e-3], [6.0, 12.0, 20.0])
        )
        return cls(masses, lengths, drives, rate, noise, seconds, float(rng.uniform(0.6, 1.6)))

    @property
    def joints(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(f"j{k}" for k in range(len(self.masses)))

    def mjcf(self, drives: dict[str, Array]) -> str:
        """With these drives."""
        text, at = "", 0.0
        for k, (name, mass, length) in enumerate(zip(self.joints, self.masses, self.lengths, strict=True)):
            text += f"""<body pos="0 0 {at}"><joint name="{name}" axis="{_AXES[k]}" damping="{drives["damping"][k]}"
            frictionloss="{drives["friction"][k]}" armature="{drives["armature"][k]}"/><geom type="capsule" contype="0"
            conaffinity="0" size="{0.15 * length}" fromto="0 0 0 0.01 0.01 {-length}" mass="{mass}"/>"""
            at = -length
        motors = "".join(f'<motor name="m{k}" joint="{name}"/>' for k, name in enumerate(self.joints))
        return f"""<mujoco><option timestep="0.001"/><worldbody>{text}{"</body>" * len(self.masses)}</worldbody>
        <actuator>{motors}</actuator></mujoco>"""

    def log(self, name: str, seed: int) -> Recording:
        """Torques and positions, from rest."""
        model, rng, n = (
            mujoco.MjModel.from_xml_string(self.mjcf(self.drives)),
            np.random.default_rng(seed),
            len(self.masses),
        )
        model.opt.timestep = _STEP
        data, when = mujoco.MjData(model), np.arange(0.0, self.seconds, 1.0 / self.rate)
        pace, phase = rng.uniform(1.0, 6.0, (n, 3)), rng.uniform(0.0, 6.0, (n, 3))
        weight = np.array([9.81 * 0.6 * float(np.sum((self.masses * self.lengths)[k:])) for k in range(n)])
        told = self.share * weight / 3.0 * np.sum(np.sin(pace * when[:, None, None] + phase), axis=2)
        seen = []
        for torque in told:
            seen.append(data.qpos + self.noise * rng.standard_normal(n))
            data.ctrl[:] = torque
            mujoco.mj_step(model, data, round(1.0 / self.rate / _STEP))
        return Recording(name, {
            "command_torque": Channel("command_torque", self.joints, "N m", when, told),
            "position": Channel("position", self.joints, "rad", when, np.array(seen)),
        })  # fmt: skip


@dataclass(frozen=True)
class Found:
    """Median error of friction, damping and inertia in %, held-out error of replays that begin anew twice a second over that
    of the true drives, CPU seconds, and how much is called identified and holds.
    """

    off: float
    over_truth: float
    cpu: float
    claims: int
    held: int


def calibrated(folder: Path, number: int, windows: float | None) -> Found:
    """Arm `number`, from one log, judged on another."""
    arm, file = Arm.drawn(number), folder / f"arm{number}.xml"
    file.write_text(arm.mjcf({kind: np.full(len(arm.masses), start) for kind, (*_, start) in KINDS.items()}))
    began = time.process_time()
    ready = prepare(file, [arm.log("fitted", number)])
    done = ready.calibrate(Options(cross_validate=False, windows=windows))
    cpu = time.process_time() - began
    truth = {f"{j}.{kind}": float(arm.drives[kind][k]) for k, j in enumerate(arm.joints) for kind in KINDS}
    judged, errors = [arm.log("judged", 5000 + number)], []
    for values in (done.values, np.array([truth.get(e.name, e.start) for e in done.estimates])):
        (shown,) = [r for r in replays(ready.simulator, values, [], judged, windows=0.5) if r.channel == "position"]
        errors.append(float(np.sqrt(np.nanmean((shown.after - shown.measured) ** 2))))
    claims = [e for e in done.estimates if e.name in truth and e.verdict == "identified"]
    off = 100.0 * float(np.median([abs(e.value / truth[e.name] - 1.0) for e in done.estimates if e.name in truth]))
    return Found(off, errors[0] / errors[1], cpu, len(claims), sum(e.low <= truth[e.name] <= e.high for e in claims))


def main() -> None:
    """Prints a line for each arm and the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="three arms")
    parser.add_argument("--arms", type=int, default=10)
    options = parser.parse_args()
    ours, whole = [], []
    print("off, %; held out over truth; CPU s; held    in windows, and whole", flush=True)
    with tempfile.TemporaryDirectory() as name:
        for number in range(3 if options.quick else options.arms):
            ours.append(calibrated(Path(name), number, None))
            whole.append(calibrated(Path(name), number, np.inf))
            print(f"arm {number}" + "".join(f"{f.off:8.1f} % {f.over_truth:8.2f} {f.cpu:6.1f} s {f.held:3d} of {f.claims:2d}"
                                            for f in (ours[-1], whole[-1])), flush=True)  # fmt: skip
    a, b = (np.array([[f.off, f.over_truth, f.cpu] for f in found]) for found in (ours, whole))
    peer = "replayed whole"
    result("swinging_arms_off_at_worst", float(a[:, 0].max()), "%", 5.0, peer=peer, peer_value=float(b[:, 0].max()))
    result("swinging_arms_held_out_at_worst", float(a[:, 1].max()), "of the true drives' error", 1.2, peer=peer,
           peer_value=float(b[:, 1].max()))  # fmt: skip
    result("swinging_arms_cpu_seconds", float(a[:, 2].sum()), "s", 1.0, ratio_goal=True, peer=peer,
           peer_value=float(b[:, 2].sum()))  # fmt: skip
    shares = [sum(f.held for f in found) / max(sum(f.claims for f in found), 1) for found in (ours, whole)]
    result("swinging_arms_coverage", shares[0], f"of {sum(f.claims for f in ours)}", 0.9, at_most=False, peer=peer,
           peer_value=shares[1])  # fmt: skip


if __name__ == "__main__":
    main()
