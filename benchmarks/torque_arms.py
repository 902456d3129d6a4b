# SPDX-License-Identifier: Apache-2.0
"""Calibrates drawn arms commanded by torque whose files know nothing of friction, rotors and damping; replays another log.

Six joints, lengths, masses and drives drawn by number; a controller that computes torques from the file's model moves them
at 250 Hz, so weak joints hang back and some hardly move. Positions have 0.2 mrad of noise. Beside it the same calibration
begun at the file's values (without `motors.drives_seen`).

Two of them move in steps other than usual: robots that are nearly continuous (0.25 ms), whose file steps by 2 ms, of which
claims must hold; and robots and files of 5 ms, beside the same calibration at 2 ms.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import mujoco
import numpy as np
from results import result

from trueup.arrays import Array
from trueup.engines.mujoco.setup import proposal
from trueup.loop.calibrate import Options
from trueup.loop.prepare import prepare
from trueup.loop.replay import replays
from trueup.recording import Channel, Recording

_AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
_JOINTS = tuple(f"j{k}" for k in range(len(_AXES)))
_STRENGTH = np.array([150.0, 150.0, 80.0, 25.0, 25.0, 10.0])  # N m, of the motors
_NOISE, _SECONDS, _STEP, _TICK = 2e-4, 8.0, 2e-3, 4e-3  # rad, s, s, s
_FINE, _LONG, _LONG_TICK = 2.5e-4, 5e-3, 5e-3  # s


@dataclass(frozen=True)
class Arm:
    """The file of an arm, what its drives truly take (6,) each, and how it is moved."""

    mjcf: str
    friction: Array
    damping: Array
    armature: Array

    @classmethod
    def drawn(cls, number: int, step: float = _STEP) -> Arm:
        """Arm `number`, whose file has a step in s."""
        rng = np.random.default_rng(number)
        lengths = np.array([0.1, 0.4, 0.35, 0.1, 0.1, 0.08]) * rng.uniform(0.7, 1.3, 6)
        masses = np.array([4.0, 5.0, 3.0, 1.5, 1.0, 0.5]) * rng.uniform(0.6, 1.4, 6)
        text, at = "", 0.0
        for name, axis, length, mass in zip(_JOINTS, _AXES, lengths, masses, strict=True):
            text += f"""<body pos="0 0 {at}"><joint name="{name}" axis="{axis}"/><geom type="capsule"
            contype="0" conaffinity="0" size="{0.25 * length}" fromto="0 0 0 0.02 0.01 {length}" mass="{mass}"/>"""
            at = length
        motors = "".join(f'<motor name="m{n}" joint="{n}"/>' for n in _JOINTS)
        mjcf = f"""<mujoco><option timestep="{step}"/><worldbody>{text}{"</body>" * 6}</worldbody>
        <actuator>{motors}</actuator></mujoco>"""
        share = rng.uniform((0.3, 0.05, 0.2), (1.5, 1.0, 1.0), (6, 3)) * (0.01, 0.01, 0.002)
        return cls(mjcf, *(share * _STRENGTH[:, None]).T)

    def log(self, name: str, seed: int, step: float = _STEP, tick: float = _TICK) -> Recording:
        """Eight seconds of sines, as far as torques reach them that are computed every `tick` s; it moves in steps in s."""
        plain, true = (mujoco.MjModel.from_xml_string(self.mjcf) for _ in range(2))
        true.dof_frictionloss[:], true.dof_damping[:], true.dof_armature[:] = self.friction, self.damping, self.armature
        true.opt.timestep = step
        mujoco.mj_setConst(true, mujoco.MjData(true))
        data, own, rng, rows = mujoco.MjData(true), mujoco.MjData(plain), np.random.default_rng(seed), []
        pace, phase = rng.uniform(0.6, 3.8, (6, 4)), rng.uniform(0.0, 2.0 * np.pi, (6, 4))
        data.qpos[:] = 0.6 * np.sin(phase).mean(axis=1)
        for k in range(round(_SECONDS / step)):
            if k % round(tick / step) == 0:
                wanted = 0.6 * np.sin(pace * data.time + phase).mean(axis=1)
                speed = 0.6 * (pace * np.cos(pace * data.time + phase)).mean(axis=1)
                own.qpos[:], own.qvel[:] = data.qpos, 0.0
                own.qacc[:] = 100.0 * (wanted - data.qpos) + 20.0 * (speed - data.qvel)
                mujoco.mj_inverse(plain, own)
                data.ctrl[:] = np.clip(own.qfrc_inverse, -_STRENGTH, _STRENGTH)
                rows.append([data.time, *(data.qpos + _NOISE * rng.standard_normal(6)), *data.ctrl])
            mujoco.mj_step(true, data)
        when, seen, told = np.split(np.array(rows), [1, 7], axis=1)
        channels = (
            ("position", _JOINTS, "rad", seen),
            ("command_torque", tuple(f"m{n}" for n in _JOINTS), "N m", told),
        )
        return Recording(
            name, {c: Channel(c, labels, unit, when[:, 0], values) for c, labels, unit, values in channels}
        )


@dataclass(frozen=True)
class Found:
    """Held-out error of replays that begin anew twice a second over that of the true drives, root mean square error in %
    of friction, damping and inertia of the five joints that move, CPU seconds, and how much is called identified and holds.
    """

    over_truth: float
    off: float
    cpu: float
    claims: int
    held: int


def calibrated(
    folder: Path, number: int, step: float = _STEP, own: float = _STEP, tick: float = _TICK, at: float | None = None
) -> Found:
    """Arm `number`, from one log, judged on another: its file has a `step` in s, the robot its `own`, and it is calibrated
    `at` one, or at its file's.
    """
    arm, file = Arm.drawn(number, step), folder / f"arm{number}.xml"
    file.write_text(arm.mjcf)
    began = time.process_time()
    ready = prepare(file, [arm.log("fitted", 1000 + number, own, tick)], step=at)
    done = ready.calibrate(Options(cross_validate=False))
    cpu = time.process_time() - began
    truth = {
        f"{j}.{kind}": float(getattr(arm, kind)[k])
        for k, j in enumerate(_JOINTS)
        for kind in ("friction", "damping", "armature")
    }
    claims = [e for e in done.estimates if e.name in truth and e.verdict == "identified"]
    judged, true = [arm.log("judged", 2000 + number, own, tick)], [truth.get(e.name, e.value) for e in done.estimates]
    errors = []
    for values in (done.values, np.array(true)):
        (shown,) = [r for r in replays(ready.simulator, values, [], judged, windows=0.5) if r.channel == "position"]
        errors.append(float(np.sqrt(np.nanmean((shown.after - shown.measured) ** 2))))
    ratios = [e.value / truth[e.name] for e in done.estimates if e.name in truth and not e.name.startswith(_JOINTS[-1])]
    off = 100.0 * float(np.sqrt(np.mean((np.array(ratios) - 1.0) ** 2)))
    return Found(errors[0] / errors[1], off, cpu, len(claims), sum(e.low <= truth[e.name] <= e.high for e in claims))


def main() -> None:
    """Prints a line for each arm and the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two arms")
    parser.add_argument("--arms", type=int, default=4)
    options = parser.parse_args()
    ours, plain = [], []
    print("held out over truth; off, %; CPU s; held    from inverse dynamics, and from the file's values", flush=True)
    with tempfile.TemporaryDirectory() as name:
        for number in range(2 if options.quick else options.arms):
            ours.append(calibrated(Path(name), number))
            with patch.object(proposal, "drives_seen", lambda model, recordings: {}):
                plain.append(calibrated(Path(name), number))
            print(f"arm {number}" + "".join(f"{f.over_truth:12.2f} {f.off:8.2f} % {f.cpu:6.1f} s {f.held:3d} of {f.claims:2d}"
                                            for f in (ours[-1], plain[-1])), flush=True)  # fmt: skip
    a, b = (np.array([[f.over_truth, f.off, f.cpu] for f in found]) for found in (ours, plain))
    for what, number in (("median", np.median), ("worst", np.max)):
        result(f"torque_arms_held_out_{what}", float(number(a[:, 0])), "of the true drives' error", 1.2,
               peer="begun at the file's values", peer_value=float(number(b[:, 0])))  # fmt: skip
    result("torque_arms_off", float(np.median(a[:, 1])), "%", 2.0, peer="begun at the file's values",
           peer_value=float(np.median(b[:, 1])))  # fmt: skip
    result("torque_arms_cpu_seconds", float(np.median(a[:, 2])), "s", 0.5, ratio_goal=True, peer="begun at the file's values",
           peer_value=float(np.median(b[:, 2])))  # fmt: skip
    result("torque_arms_coverage", sum(f.held for f in ours) / max(sum(f.claims for f in ours), 1),
           f"of {sum(f.claims for f in ours)}", 0.95, at_most=False)  # fmt: skip
    _at_other_steps()


def _at_other_steps() -> None:
    """Prints the figures of robots that move in other steps."""
    fine, own, usual = list[Found](), list[Found](), list[Found]()
    with tempfile.TemporaryDirectory() as name:
        for number in range(2):
            fine.append(calibrated(Path(name), number, own=_FINE))
            own.append(calibrated(Path(name), number, _LONG, _LONG, _LONG_TICK))
            usual.append(calibrated(Path(name), number, _LONG, _LONG, _LONG_TICK, at=_STEP))
    result("torque_arms_fine_coverage", sum(f.held for f in fine) / max(sum(f.claims for f in fine), 1),
           f"of {sum(f.claims for f in fine)}", 0.95, at_most=False)  # fmt: skip
    result("torque_arms_own_step_off", float(np.mean([f.off for f in own])), "%", 1.0, ratio_goal=True, peer="at 2 ms",
           peer_value=float(np.mean([f.off for f in usual])))  # fmt: skip


if __name__ == "__main__":
    main()
