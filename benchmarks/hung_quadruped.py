# SPDX-License-Identifier: Apache-2.0
"""Calibrates a drawn quadruped that hangs, with 12 position servos, from three logs of 8 s; replays another one.

The robot steps by 0.2 ms, the file by 2, with other gains, frictions and rotors than the robot's. Positions have 0.3 mrad of
noise, at 200 Hz. Beside the width of the stiffnesses' intervals stands by how much these are off: an interval is to hold the
truth, and to tell something.
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
from trueup.loop.prepare import prepare
from trueup.loop.replay import replays
from trueup.recording import Channel, Recording

_NOISE, _FINE, _RATE = 3e-4, 2e-4, 200.0  # rad, s, Hz
_LINKS = (
    ("hip", 60.0, 0.012, 0.3, 0.0, 0.25),
    ("thigh", 50.0, 0.01, 0.25, 0.7, 0.35),
    ("calf", 40.0, 0.008, 0.2, -1.4, 0.4),
)
"""Joint, kp in N m/rad, armature in kg m^2, friction in N m, where it rests and how far it moves in rad."""
_LEGS = {"FL": (0.2, 0.1), "FR": (0.2, -0.1), "RL": (-0.2, 0.1), "RR": (-0.2, -0.1)}
_HOME, _REACH = (np.tile([link[k] for link in _LINKS], len(_LEGS)) for k in (4, 5))
_DRIVES = tuple(f"{leg}_{link[0]}" for leg in _LEGS for link in _LINKS)
_LEG = """<body pos="{x} {y} 0"><inertial pos="0 0 0" mass=".6" diaginertia="8e-4 8e-4 8e-4"/>
<joint name="{leg}_hip" axis="1 0 0" {hip}/>
<body pos="0 {side} 0"><inertial pos="0 0 -.08" mass="1" diaginertia="6e-3 6e-3 1e-3"/>
<joint name="{leg}_thigh" axis="0 1 0" {thigh}/>
<body pos="0 0 -.21"><inertial pos="0 0 -.1" mass=".2" diaginertia="1.5e-3 1.5e-3 1e-4"/>
<joint name="{leg}_calf" axis="0 1 0" {calf}/></body></body></body>
"""


def _mjcf(values: Array, step: float) -> str:
    """A quadruped whose drives have `values` (12, 3): kp, armature and friction; kv is a thirtieth of kp."""
    drives = dict(zip(_DRIVES, values, strict=True))
    joint = 'armature="{1}" frictionloss="{2}" damping=".05"'
    legs = "".join(
        _LEG.format(x=x, y=y, side=0.8 * y, leg=leg, **{n: joint.format(*drives[f"{leg}_{n}"]) for n, *_ in _LINKS})
        for leg, (x, y) in _LEGS.items()
    )
    servos = "".join(
        f'<position name="{n}" joint="{n}" kp="{kp}" kv="{kp / 30.0}" forcerange="-33.5 33.5"/>\n'
        for n, (kp, *_) in drives.items()
    )
    return f"""<mujoco><compiler angle="radian"/><option timestep="{step}" integrator="implicitfast"/>
    <worldbody><body pos="0 0 1"><inertial pos="0 0 0" mass="6" diaginertia=".1 .2 .2"/>{legs}</body></worldbody>
    <actuator>{servos}</actuator></mujoco>"""


def _commands(name: str, time: Array, rng: np.random.Generator) -> Array:
    """(T, 12) sines that become faster, or steps, from where it rests."""
    n = len(_DRIVES)
    if name == "steps":
        targets = rng.uniform(-1.0, 1.0, (n, 1 + int(time[-1] / 0.7)))
        targets[:, 0] = 0.0
        return np.asarray(_HOME + _REACH * targets[:, (time / 0.7).astype(int)].T)
    slow, fast, phase = rng.uniform(0.3, 0.8, n), rng.uniform(1.5, 3.0, n), rng.uniform(0.0, 6.3, n)
    turned = 2.0 * np.pi * (slow * time[:, None] + 0.5 * (fast - slow) * time[:, None] ** 2 / time[-1]) + phase
    return np.asarray(_HOME + _REACH * np.clip(time[:, None] / 0.5, 0.0, 1.0) * np.sin(turned))


def _log(robot: mujoco.MjModel, name: str, seconds: float, rng: np.random.Generator) -> Recording:
    time = np.arange(round(seconds * _RATE)) / _RATE
    told, seen, data = _commands(name, time, rng), [], mujoco.MjData(robot)
    data.qpos[:] = data.ctrl[:] = _HOME
    mujoco.mj_step(robot, data, round(2.0 / _FINE))  # it has come to rest
    for row in told:
        data.ctrl[:] = row
        seen.append(data.qpos + rng.normal(0.0, _NOISE, len(row)))
        mujoco.mj_step(robot, data, round(1.0 / _RATE / _FINE))
    both = (("position", np.array(seen)), ("command", told))
    return Recording(name, {n: Channel(n, _DRIVES, "rad", time, values) for n, values in both})


@dataclass(frozen=True)
class Found:
    """Held-out error over the noise, CPU s, claims, how many hold; of stiffnesses half their intervals and errors, in %."""

    over_noise: float
    cpu: float
    claims: int
    held: int
    width: float
    off: float


def calibrated(folder: Path, number: int, seconds: float) -> Found:
    """Quadruped `number`, from three logs, judged on another."""
    rng = np.random.default_rng([number, 20261201])
    usual = np.tile([link[1:4] for link in _LINKS], (len(_LEGS), 1))
    own = usual * np.exp(rng.normal(0.0, (0.1, 0.2, 0.2), usual.shape))
    robot = mujoco.MjModel.from_xml_string(_mjcf(own, _FINE))
    file = folder / f"quadruped{number}.xml"
    file.write_text(_mjcf(np.full(usual.shape, (50.0, 0.005, 0.1)), 2e-3))
    logs = [_log(robot, name, seconds, rng) for name in ("sines", "steps", "sines", "steps")]
    logs = [log.replace(name=f"{log.name} {k}") for k, log in enumerate(logs)]
    began = time.process_time()
    ready = prepare(file, logs[:3])
    done = ready.calibrate()
    cpu = time.process_time() - began
    (shown,) = [r for r in replays(ready.simulator, done.values, [], logs[3:]) if r.channel == "position"]
    kinds = zip(("kp", "armature", "friction"), own.T, strict=True)
    truth = {f"{n}.{kind}": float(v) for kind, values in kinds for n, v in zip(_DRIVES, values, strict=True)}
    fitted = [(e, truth[e.name]) for e in done.estimates if e.name in truth and e.fitted]
    claims = [e.low <= true <= e.high for e, true in fitted if e.verdict == "identified"]
    stiff = np.array(
        [(0.5 * (e.high - e.low) / t, abs(e.value / t - 1.0)) for e, t in fitted if e.name.endswith(".kp")]
    )
    error = float(np.sqrt(np.nanmean((shown.after - shown.measured) ** 2)))
    return Found(error / _NOISE, cpu, len(claims), sum(claims), *np.median(100.0 * stiff, axis=0).tolist())


def main() -> None:
    """Prints a line for each quadruped and the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="logs of 3 s")
    parser.add_argument("--robots", type=int, default=1)
    options = parser.parse_args()
    found = []
    print("robot  held out over noise  CPU s  identified that hold  stiffnesses: intervals  off", flush=True)
    with tempfile.TemporaryDirectory() as name:
        for number in range(options.robots):
            f = calibrated(Path(name), number, 3.0 if options.quick else 8.0)
            found.append(f)
            print(f"{number:5d} {f.over_noise:20.3f} {f.cpu:6.1f} {f.held:14d} of {f.claims:3d} {f.width:18.2f} % "
                  f"{f.off:5.2f} %", flush=True)  # fmt: skip
    claims, held = (sum(getattr(f, k) for f in found) for k in ("claims", "held"))
    result("hung_quadruped_held_out", max(f.over_noise for f in found), "of the noise", 1.1)
    result("hung_quadruped_identified_hold", 100.0 * held / max(claims, 1), "%", 90.0, at_most=False)
    result("hung_quadruped_stiffness_interval", max(f.width for f in found), "%", 5.0, peer="what they are off",
           peer_value=max(f.off for f in found))  # fmt: skip


if __name__ == "__main__":
    main()
