# SPDX-License-Identifier: Apache-2.0
"""Robots that walk on four feet under position servos: is what they are made of found from two walks, others foretold?

Eight drives (or twelve: `--twelve`, whose hips roll, too), a free base, feet that touch, slide and let go. The simulator is
told of none of what differs: gains, friction, damping, inertia of drives, mass and centre of the trunk, floor, a command that
is one sample late (`--late 3`: three). Only what force scales alike (gains, masses, friction, inertia) is seen but for the
masses of the legs, which are right: errors are of ratios to the stiffness. Beside the calibration stand the same without
slopes that are weighed together, and the same by slopes on whole walks, without windows.
"""

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray
from results import result

from trueup.calibration import Calibration
from trueup.loop.calibrate import Options
from trueup.loop.fit import STAGES
from trueup.loop.prepare import Preparation, prepare
from trueup.loop.replay import replays
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]

_LEGS = ("fl", "fr", "hl", "hr")
_PARTS = {"roll": 0.0, "hip": 0.8, "knee": -1.5}  # rad, standing
_SWAY = 0.06  # rad
_JUDGED = ((1.7, 1.0), (2.2, 0.7), (1.3, 0.9), (1.9, 0.85), (1.6, 0.75))  # Hz and rad of walks that are left out
_INERTIA = (0.02, 0.07, 0.08)  # kg m2 of the trunk, whatever its mass: what is heavier sits in the middle
_STEP, _RATE, _SECONDS = 0.002, 100.0, 5.0  # s, Hz, s of each walk
_PEER = "by slopes on whole walks"
_HAIRS = "by differences by a hair"
_METHODS = {
    "as it comes": Options(cross_validate=False),
    _HAIRS: Options(stages=tuple(s for s in STAGES if s.name != "weighing"), cross_validate=False),
    _PEER: Options(search="gradient", windows=np.inf, cross_validate=False),
}


@dataclass(frozen=True)
class Walker:
    """What a robot is made of, in SI; the defaults are what its file says."""

    kp: float = 60.0
    kv: float = 2.0
    friction: float = 0.1
    damping: float = 0.05
    armature: float = 0.01
    trunk: float = 5.0
    forward: float = 0.0
    floor: float = 0.8
    rolls: bool = False
    """Whether its hips have a drive to roll with."""
    late: int = 1
    """By how many samples its commands are late."""

    @classmethod
    def drawn(cls, number: int, *, rolls: bool = False, late: int = 1) -> Walker:
        """Robot `number`: each of these by up to two fifths off, friction and inertia of drives by up to the double."""
        rng = np.random.default_rng(number)
        off = {
            f.name: f.default * np.exp(rng.uniform(-0.35, 0.35)) for f in fields(cls) if f.name not in ("rolls", "late")
        }
        off["friction"], off["armature"] = (off[n] * np.exp(rng.uniform(0.0, 0.35)) for n in ("friction", "armature"))
        return cls(**{**off, "forward": rng.uniform(-0.03, 0.03)}, rolls=rolls, late=late)

    @property
    def parts(self) -> dict[str, float]:
        """The drives of a leg, and how these stand in rad."""
        return {part: at for part, at in _PARTS.items() if self.rolls or part != "roll"}

    @property
    def joints(self) -> tuple[str, ...]:
        """All drives."""
        return tuple(f"{leg}_{part}" for leg in _LEGS for part in self.parts)

    @property
    def mjcf(self) -> str:
        """The robot as a model file."""
        roll = '<joint name="{}_roll" axis="1 0 0"/>' if self.rolls else ""
        legs = "".join(
            f'<body name="{leg}_thigh" pos="{x} {y} 0">{roll.format(leg)}<joint name="{leg}_hip" axis="0 1 0"/>'
            '<inertial mass="1" pos="0 0 -0.05" diaginertia="0.005 0.005 0.001"/>'
            f'<body name="{leg}_shank" pos="0 0 -0.21"><joint name="{leg}_knee" axis="0 1 0"/>'
            '<inertial mass="0.2" pos="0 0 -0.1" diaginertia="0.001 0.001 0.00005"/>'
            f'<geom name="{leg}_foot" type="sphere" size="0.02" pos="0 0 -0.21"/></body></body>'
            for leg, x, y in zip(_LEGS, (0.19, 0.19, -0.19, -0.19), (0.12, -0.12, 0.12, -0.12), strict=True)
        )
        servos = "".join(f'<position name="{j}" joint="{j}" kp="{self.kp}" kv="{self.kv}"/>' for j in self.joints)
        return f"""<mujoco model="walker"><compiler angle="radian"/>
        <option timestep="{_STEP}" integrator="implicitfast"/>
        <default><joint armature="{self.armature}" damping="{self.damping}" frictionloss="{self.friction}"/></default>
        <worldbody><geom name="floor" type="plane" size="9 9 0.1" friction="{self.floor} 0.005 0.0001" priority="1"/>
        <body name="trunk" pos="0 0 0.34"><freejoint/>
        <inertial mass="{self.trunk}" pos="{self.forward} 0 0" diaginertia="{" ".join(map(str, _INERTIA))}"/>
        <geom type="box" size="0.2 0.06 0.05" contype="0" conaffinity="0"/>{legs}</body></worldbody>
        <actuator>{servos}</actuator></mujoco>"""

    def walk(self, name: str, pace: float, height: float, seed: int) -> Recording:
        """A trot at `pace` (Hz) with steps of `height` (rad) as it was measured."""
        rng, model = np.random.default_rng(seed), mujoco.MjModel.from_xml_string(self.mjcf)
        data, stand = mujoco.MjData(model), np.tile([*self.parts.values()], len(_LEGS))
        data.qpos[7:], data.ctrl[:] = stand, stand
        mujoco.mj_step(model, data, 1000)
        instants = np.arange(0.0, _SECONDS, 1.0 / _RATE)
        commands, rows = np.array([self.trot(t, pace, height) for t in instants]), []
        for arriving in np.concatenate([np.tile(stand, (self.late, 1)), commands])[: len(commands)]:
            rows.append(np.concatenate([data.qpos[7:], data.qpos[:7]]))
            data.ctrl[:] = arriving
            mujoco.mj_step(model, data, round(1.0 / _RATE / _STEP))
        seen = np.array(rows) + rng.normal(
            0.0, np.repeat([1e-3, 5e-4], [len(self.joints), 7]), (len(rows), len(self.joints) + 7)
        )
        joints, base = seen[:, : len(self.joints)], seen[:, len(self.joints) :]
        return Recording(name, {
            "command": Channel("command", self.joints, "rad", instants, commands),
            "position": Channel("position", self.joints, "rad", instants, joints),
            "base_position": Channel("base_position", ("x", "y", "z"), "m", instants, base[:, :3]),
            "base_orientation": Channel("base_orientation", ("w", "x", "y", "z"), "", instants, base[:, 3:]),
        })  # fmt: skip

    def trot(self, time: float, pace: float, height: float) -> Array:
        """(n,) rad commanded after so many s; where hips roll it sways."""
        command, more, each = np.tile([*self.parts.values()], len(_LEGS)), min(1.0, time), len(self.parts)
        for k, phase in enumerate((0.0, np.pi, np.pi, 0.0)):
            swing = 2.0 * np.pi * pace * time + phase
            lift = max(0.0, float(np.sin(swing))) * 0.5 * height * more
            hip = each * k + each - 2
            command[hip] += 0.2 * height * np.cos(swing) * more + lift
            command[hip + 1] -= 2.0 * lift
            if self.rolls:
                command[hip - 1] += _SWAY * np.sin(np.pi * pace * time) * more
        return command


def off(found: Calibration, truth: Walker) -> dict[str, float]:
    """By how many % ratios to the stiffness are off, the median over drives."""
    value = {e.name: e.value for e in found.estimates}
    stiff = np.array([value[f"{j}.kp"] for j in truth.joints]) / truth.kp
    kv = [value.get(f"{j}.kv", truth.kv) + value.get(f"{j}.damping", truth.damping) for j in truth.joints]
    ratios = {
        "damping": np.array(kv) / (truth.kv + truth.damping),
        "friction": np.array([value.get(f"{j}.friction", 0.0) for j in truth.joints]) / truth.friction,
        "armature": np.array([value.get(f"{j}.armature", 0.0) for j in truth.joints]) / truth.armature,
        "mass": np.array([value.get("trunk.mass", 5.0) + 4.8]) / (truth.trunk + 4.8),
    }
    return {name: float(100.0 * np.median(np.abs(ratio / stiff - 1.0))) for name, ratio in ratios.items()}


def true_values(ready: Preparation, robot: Walker) -> Array:
    """(n,) what the robot is made of, as values of what is calibrated; the rest as it is without."""
    truth = {**{f.name: getattr(robot, f.name) for f in fields(Walker)}, "delay": robot.late / _RATE, "mass": robot.trunk,
             "com_x": robot.forward, "floor_friction": robot.floor}  # fmt: skip
    space = ready.simulator.parameters
    if not any(n.endswith(".damping") for n in space.names):  # of servo and joint one is searched, and stands for both
        truth["kv"] += robot.damping - Walker().damping
    values = space.without([p.name for p in space.parameters if p.optional and p.absent is not None]).nominal
    radii = 0.5 * sum(_INERTIA) - np.array(_INERTIA)
    truth |= {f"spread_{a}": float(np.sqrt(r / robot.trunk)) for a, r in zip("xyz", radii, strict=True)}
    own = [
        v if p.optional else truth.get(p.name.split(".")[-1], v) for p, v in zip(space.parameters, values, strict=True)
    ]
    return np.array(own)


def held(ready: Preparation, found: Calibration, robot: Walker) -> list[bool]:
    """Which of the intervals of what is called identified hold what the robot is made of."""
    truth = dict(zip(ready.simulator.parameters.names, true_values(ready, robot), strict=True))
    return [e.low <= truth[e.name] <= e.high for e in found.estimates if e.verdict == "identified"]


def led(ready: Preparation, values: Array, judged: Sequence[Recording]) -> float:
    """Root mean square error in rad of joints foretold half a second at a time, the median over all these."""
    shown = [r for r in replays(ready.simulator, values, [], judged, windows=0.5) if r.channel == "position"]
    parts = [part for r in shown for part in np.array_split(r.after - r.measured, round(_SECONDS / 0.5))]
    return float(np.median([np.sqrt(np.nanmean(part**2)) for part in parts]))


def main() -> None:
    """Prints RESULT lines."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one robot in place of three")
    parser.add_argument("--twelve", action="store_true", help="robots whose hips roll, not on whole walks")
    parser.add_argument("--late", type=int, default=1, help="samples of 10 ms by which commands are late")
    asked = parser.parse_args()
    methods = {n: how for n, how in _METHODS.items() if not asked.twelve or n != _PEER}
    rows: dict[str, list[tuple[float, float, float]]] = {method: [] for method in methods}
    kept: dict[str, list[bool]] = {method: [] for method in methods}
    print(
        "robot  method                   held out, of the truth's   off, %: damping friction armature mass   CPU s  held"
    )
    for number in range(1 if asked.quick else 3):
        robot = Walker.drawn(number, rolls=asked.twelve, late=asked.late)
        walks = [robot.walk(f"walk{k}", *how, 10 * number + k) for k, how in enumerate(((2.0, 0.8), (1.5, 0.9)))]
        judged = [robot.walk(f"judged{k}", *how, 1000 + 10 * number + k) for k, how in enumerate(_JUDGED)]
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "walker.xml"
            file.write_text(Walker(rolls=asked.twelve).mjcf)
            for method, options in methods.items():
                began = time.process_time()
                ready = prepare(file, walks)
                found = ready.calibrate(options)
                spent, apart = time.process_time() - began, off(found, robot)
                error = led(ready, found.values, judged) / led(ready, true_values(ready, robot), judged)
                told = " ".join(f"{apart[n]:8.1f}" for n in ("damping", "friction", "armature", "mass"))
                claims = held(ready, found, robot)
                row = f"{number:5d}  {method:24s} {error:8.2f}                    {told}   {spent:7.0f}"
                delay = " ".join(
                    f"delay {1e3 * e.value:.1f} [{1e3 * e.low:.1f}, {1e3 * e.high:.1f}] ms"
                    for e in found.estimates
                    if e.name.split(".")[-1] == "delay"
                )
                print(f"{row}  {sum(claims)} of {len(claims)}  {delay}", flush=True)
                rows[method].append((error, float(np.mean(list(apart.values()))), spent))
                kept[method] += claims
    ours, hairs = (float(np.mean(kept[method])) for method in ("as it comes", _HAIRS))
    result("walkers_claims_in_intervals", ours, "", 0.9, peer=_HAIRS, peer_value=hairs)
    if asked.twelve:
        return
    own, peer = (np.median(rows[method], axis=0).tolist() for method in ("as it comes", _PEER))
    result("walkers_held_out", own[0], "of the truth's", 1.2, peer=_PEER, peer_value=peer[0])
    result("walkers_off", own[1], "%", 10.0, peer=_PEER, peer_value=peer[1])
    result("walkers_cpu", own[2], "s", 1.0, peer=_PEER, peer_value=peer[2], ratio_goal=True)


if __name__ == "__main__":
    main()
