# SPDX-License-Identifier: Apache-2.0
"""Calibrates a drawn upper body, two arms on a waist with 13 position servos, from three logs of 10 s; replays another one.

The file is wrong in all gains, dampings, frictions and rotors, and commands act 12 ms late. Positions have 1 mrad of noise,
at 50 Hz. Beside the CPU seconds stands what slopes by differences cost once: a simulation of all logs for each parameter.
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

from trueup.loop.prepare import prepare
from trueup.loop.replay import replays
from trueup.recording import Channel, Recording
from trueup.trial import Trial

_NOISE, _STEP, _EVERY, _DELAY = 1e-3, 2e-3, 10, 6  # rad, s, steps, steps
_ARM = (
    ("pitch", "0 1 0", 90.0, 1.8, 0.08),
    ("roll", "1 0 0", 90.0, 1.5, 0.1),
    ("yaw", "0 0 1", 60.0, 1.0, 0.12),
    ("elbow", "0 1 0", 60.0, 1.0, 0.12),
    ("twist", "0 0 1", 30.0, 0.5, 0.08),
    ("wrist", "0 1 0", 30.0, 0.5, 0.1),
)
"""Joint, axis, N m/rad, kg and m of an arm."""
_DRIVES = {"waist": 200.0, **{f"{side}_{row[0]}": row[2] for side in ("left", "right") for row in _ARM}}
_KINDS = ("kp", "kv", "armature", "damping", "friction")


@dataclass(frozen=True)
class Body:
    """The file of an upper body, and what its drives truly are, by parameter."""

    file: str
    robot: str
    truth: dict[str, float]

    @classmethod
    def drawn(cls, number: int) -> Body:
        """Body `number`."""
        rng = np.random.default_rng(number)
        shape = rng.uniform(0.8, 1.25, (2, len(_ARM)))
        shipped, true = {}, {}
        for joint, kp in _DRIVES.items():
            own = np.array([kp, 0.02 * kp, kp / 6000.0, 0.005 * kp, 0.003 * kp])
            shipped |= {f"{joint}.{k}": float(v) for k, v in zip(_KINDS, own, strict=True)}
            own = own * np.exp(rng.normal(0.0, (0.25, 0.25, 0.5, 0.5, 0.5)))
            true |= {f"{joint}.{k}": float(v) for k, v in zip(_KINDS, own, strict=True)}
        return cls(_mjcf(shape, shipped), _mjcf(shape, true), true)

    def log(self, name: str, seconds: float, seed: int) -> Recording:
        """Sines, or `steps`, of all drives at once."""
        model, rng, n = mujoco.MjModel.from_xml_string(self.robot), np.random.default_rng(seed), len(_DRIVES)
        data, time_ = mujoco.MjData(model), np.arange(0.0, seconds, _STEP * _EVERY)
        if name == "steps":
            told = rng.uniform(-0.4, 0.4, (int(seconds / 1.2) + 1, n))[(time_ / 1.2).astype(int)]
        else:
            pace, phase = rng.uniform(0.6, 7.0, (3, n)), rng.uniform(0.0, 2.0 * np.pi, (3, n))
            told = 0.4 * np.sin(time_[:, None, None] * pace + phase).mean(axis=1)
        told = told * np.minimum(time_, 1.0)[:, None]
        seen = np.zeros_like(told)
        for k in range(-1000, len(time_) * _EVERY):
            if k >= 0 and k % _EVERY == 0:
                seen[k // _EVERY] = data.qpos + _NOISE * rng.standard_normal(n)
            data.ctrl[:] = told[max(k - _DELAY, 0) // _EVERY]
            mujoco.mj_step(model, data)
        rows = (("position", seen), ("command", told))
        return Recording(name, {c: Channel(c, tuple(_DRIVES), "rad", time_, v) for c, v in rows})


def _mjcf(shape: np.ndarray, drives: dict[str, float]) -> str:
    def joint(name: str, axis: str) -> str:
        more = f'armature="{drives[f"{name}.armature"]}" damping="{drives[f"{name}.damping"]}"'
        return f'<joint name="{name}" axis="{axis}" {more} frictionloss="{drives[f"{name}.friction"]}"/>'

    text = f'<body>{joint("waist", "0 0 1")}<geom type="box" size="0.08 0.12 0.2" pos="0 0 0.2" mass="12"/>'
    for side, y in (("left", 0.2), ("right", -0.2)):
        at = f"0 {y} 0.4"
        for (name, axis, _, mass, length), wide, long in zip(_ARM, *shape, strict=True):
            text += f'<body pos="{at}">{joint(f"{side}_{name}", axis)}<geom type="capsule" size="0.03" '
            text += f'fromto="0 0 0 0.02 0 {-length * long}" mass="{mass * wide}"/>'
            at = f"0 0 {-length * long}"
        text += "</body>" * len(_ARM)
    servos = "".join(
        f'<position name="{n}" joint="{n}" kp="{drives[f"{n}.kp"]}" kv="{drives[f"{n}.kv"]}"/>' for n in _DRIVES
    )
    return f"""<mujoco><compiler angle="radian"/><option timestep="{_STEP}" integrator="implicitfast"/>
    <default><geom contype="0" conaffinity="0"/></default><worldbody>{text}</body></worldbody>
    <actuator>{servos}</actuator></mujoco>"""


@dataclass(frozen=True)
class Found:
    """Held-out error over the noise, CPU seconds, those of slopes once, numbers called identified and how many hold, and
    the worst error in % of a stiffness.
    """

    over_noise: float
    cpu: float
    slopes: float
    claims: int
    held: int
    stiffness: float


def calibrated(folder: Path, number: int, seconds: float) -> Found:
    """Body `number`, from three logs, judged on another."""
    body, file = Body.drawn(number), folder / f"body{number}.xml"
    file.write_text(body.file)
    logs = [body.log(name, seconds, 10 * number + k) for k, name in enumerate(("sines", "steps", "more"))]
    began = time.process_time()
    ready = prepare(file, logs)
    done = ready.calibrate()
    cpu = time.process_time() - began
    judged = [body.log("judged", seconds, 10 * number + 9)]
    (shown,) = [r for r in replays(ready.simulator, done.values, [], judged) if r.channel == "position"]
    error = float(np.sqrt(np.nanmean((shown.after - shown.measured) ** 2)))
    claims = [e for e in done.estimates if e.name in body.truth and e.verdict == "identified"]
    off = [abs(e.value / body.truth[e.name] - 1.0) for e in done.estimates if e.name.endswith(".kp")]
    held = sum(e.low <= body.truth[e.name] <= e.high for e in claims)
    rows = np.repeat(ready.simulator.parameters.nominal[None], int(ready.simulator.parameters.free.sum()), axis=0)
    rows += 1e-6 * np.random.default_rng(0).uniform(size=rows.shape)
    began = time.process_time()
    ready.simulator.rollout([Trial.of(log, ["position"]) for log in ready.recordings], rows)
    return Found(error / _NOISE, cpu, time.process_time() - began, len(claims), held, 100.0 * max(off))


def main() -> None:
    """Prints a line for each body and the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="logs of 3 s")
    parser.add_argument("--bodies", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    options = parser.parse_args()
    found = []
    print("body  held out over noise  CPU s  slopes once  identified that hold  worst stiffness", flush=True)
    with tempfile.TemporaryDirectory() as name:
        for number in range(options.first, options.first + options.bodies):
            f = calibrated(Path(name), number, 3.0 if options.quick else 10.0)
            found.append(f)
            print(f"{number:4d} {f.over_noise:20.3f} {f.cpu:6.1f} {f.slopes:12.1f} {f.held:14d} of {f.claims:3d} "
                  f"{f.stiffness:14.1f} %", flush=True)  # fmt: skip
    claims, held = (sum(getattr(f, k) for f in found) for k in ("claims", "held"))
    result("many_joints_cpu", float(np.median([f.cpu for f in found])), "s", 8.0, peer="slopes once",
           peer_value=float(np.median([f.slopes for f in found])), ratio_goal=True)  # fmt: skip
    result("many_joints_held_out", max(f.over_noise for f in found), "of the noise", 1.1)
    result("many_joints_identified_hold", 100.0 * held / max(claims, 1), "%", 90.0, at_most=False)


if __name__ == "__main__":
    main()
