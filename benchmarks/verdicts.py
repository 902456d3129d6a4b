# SPDX-License-Identifier: Apache-2.0
"""Is what is called 'identified' so? Servo arms with tied, unreachable and absent structures, calibrated as the command does.

Each arm has two joints with hidden gains, dampings, frictions and rotors. Its file is wrong in all of them by up to
three times; damping of the servo is one number with that of the joint, limits are mostly not reached, and half of the
arms have what the simulator lacks: an elastic gear, backlash behind the drive, or friction of another form. What counts
are estimates called 'identified', and sums named for those called 'tied': how many hold the truth within their 95 %
interval, and how many are wrong by more than a fifth. Beside it the same count for intervals that take as known what was
not asked for, as least squares has it.
"""

from __future__ import annotations

import argparse
import os
import re
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from results import result

from trueup.calibration import Calibration, Estimate
from trueup.loop import calibrate as loop_calibrate
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording
from trueup.trial import Trial

TIME = np.arange(0.0, 6.0, 0.01)
NOISE = 3e-4  # rad
STRUCTURES = ("none", "none", "elastic", "backlash", "none", "friction")
JOINT = """<joint name="{name}" axis="{axis}" range="-3 3" damping="{damping}" armature="{armature}"
 frictionloss="{friction}"/>"""
GEAR = {
    "none": "",
    "elastic": '<joint name="{name}_gear" axis="{axis}" stiffness="900" damping="0.6"/>',
    "friction": "",
    "backlash": '<joint name="{name}_gear" axis="{axis}" limited="true" range="-.004 .004" damping="0.02" armature="1e-4"/>',
}
FRICTION = {"friction_static": 0.1, "friction_load": 0.08}
"""N m above Coulomb friction at rest, and friction for each N m of load."""
ARM = """<mujoco><compiler angle="radian" autolimits="true"/><option integrator="implicitfast"/><worldbody>
<body name="upper">{j0}<inertial pos="0 0 -.001" mass=".02" diaginertia="1e-5 1e-5 1e-5"/><body name="upper_arm">{g0}
 <geom type="capsule" fromto="0 0 0 0 0 -.25" size=".03" mass="1.2"/>
 <body name="lower" pos="0 0 -.25">{j1}<inertial pos="0 0 -.001" mass=".02" diaginertia="1e-5 1e-5 1e-5"/>
  <body name="lower_arm">{g1}<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".025" mass=".6"/></body></body></body></body>
</worldbody><contact><exclude body1="upper" body2="lower"/><exclude body1="upper_arm" body2="lower_arm"/>
<exclude body1="upper_arm" body2="lower"/><exclude body1="upper" body2="lower_arm"/></contact>
<actuator><position name="a" joint="a" kp="{kp0}" kv="{kv0}" forcerange="-{limit} {limit}"/>
<position name="b" joint="b" kp="{kp1}" kv="{kv1}" forcerange="-{limit} {limit}"/></actuator></mujoco>"""
"""Joint and what its gear adds are in bodies of their own, so that all arms weigh the same."""


@dataclass(frozen=True)
class Arm:
    """What an arm hides, by joint; the file's own numbers have the same form."""

    kp: tuple[float, float]
    kv: tuple[float, float]
    damping: tuple[float, float]
    friction: tuple[float, float]
    armature: tuple[float, float]
    limit: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Arm:
        """One of a family of servo arms."""
        pair = lambda low, high: tuple(np.exp(rng.uniform(np.log(low), np.log(high), 2)).tolist())  # noqa: E731
        return cls(pair(30, 90), pair(0.5, 3), pair(0.05, 1), pair(0.05, 0.4), pair(0.005, 0.04), 40.0)

    def mistaken(self, rng: np.random.Generator) -> Arm:
        """The same as a file may have it: wrong by up to a factor of three."""
        wrong = {n: tuple((np.array(getattr(self, n)) * 3.0 ** rng.uniform(-1, 1, 2)).tolist())
                 for n in ("kp", "kv", "damping", "friction", "armature")}  # fmt: skip
        return Arm(**wrong, limit=self.limit)

    def text(self, structure: str = "none") -> str:
        """As MJCF."""
        axes = "0 1 0", "1 0 0"
        parts = {f"j{k}": JOINT.format(name="ab"[k], axis=axes[k], damping=self.damping[k], armature=self.armature[k],
                                       friction=self.friction[k]) for k in (0, 1)}  # fmt: skip
        gears = {f"g{k}": GEAR[structure].format(name="ab"[k], axis=axes[k]) for k in (0, 1)}
        return ARM.format(**parts, **gears, kp0=self.kp[0], kp1=self.kp[1], kv0=self.kv[0], kv1=self.kv[1],
                          limit=self.limit)  # fmt: skip


@dataclass(frozen=True)
class Count:
    """What came of one arm: of all that was called identified, how much was held and how much was far off."""

    structure: str
    claims: int
    held: int
    wrong: tuple[str, ...]
    plain_claims: int
    plain_held: int


def motions(truth: Path, structure: str, rng: np.random.Generator) -> list[Recording]:
    """Multisines and steps that the true arm was sent, and where its encoders say it went."""
    hidden = truth.with_suffix(".toml")
    lines = FRICTION.items() if structure == "friction" else ()
    hidden.write_text("".join(f'[[parameter]]\nquantity = "{q}"\nof = "*"\nnominal = {v}\n' for q, v in lines))
    robot = prepare(truth, (), parameters=hidden if lines else None, propose=False).simulator
    runs = []
    for name in ("waves", "more waves", "steps"):
        if name == "steps":
            command = np.repeat(rng.uniform(-0.5, 0.5, (6, 2)), len(TIME) // 6, axis=0)
        else:
            phases = rng.uniform(0, 6.3, (4, 2))
            command = sum(a * np.sin(2 * np.pi * f * TIME[:, None] + p)
                          for a, f, p in zip((0.4, 0.2, 0.1, 0.05), (0.2, 0.6, 1.4, 3.0), phases, strict=True))  # fmt: skip
        sent = Channel("command", ("a", "b"), "rad", TIME, np.asarray(command))
        plan = Recording(name, {"command": sent, "position": sent.replace(name="position")})
        (seen,) = robot.rollout([Trial.of(plan)], robot.parameters.nominal[None])
        measured = seen.channels["position"][0] + rng.normal(0.0, NOISE, (len(TIME), 2))
        runs.append(
            Recording(name, {"command": sent, "position": Channel("position", ("a", "b"), "rad", TIME, measured)})
        )
    return runs


def counted(number: int) -> Count:
    """One arm, calibrated with what is proposed for it."""
    rng = np.random.default_rng([number, 20261122])
    structure = STRUCTURES[number % len(STRUCTURES)]
    arm = Arm.drawn(rng)
    with tempfile.TemporaryDirectory() as folder:
        truth, file = Path(folder) / "truth.xml", Path(folder) / "arm.xml"
        truth.write_text(arm.text(structure))
        wrong = arm.mistaken(rng)
        file.write_text(wrong.text())
        recordings = motions(truth, structure, rng)
        with_twins = prepare(file, recordings).calibrate()
        taken, loop_calibrate.considered = loop_calibrate.considered, lambda problem, fit, covariance: ()
        try:
            plain = prepare(file, recordings).calibrate()
        finally:
            loop_calibrate.considered = taken
    claims, held, off = judged(with_twins, arm)
    plain_claims, plain_held, _ = judged(plain, arm)
    return Count(structure, claims, held, off, plain_claims, plain_held)


def judged(found: Calibration, arm: Arm) -> tuple[int, int, tuple[str, ...]]:
    """How many estimates claim to be identified, how many of these hold the truth, and which are off by a fifth."""
    claims = held = 0
    off = []
    for e in found.estimates:
        claim = claimed(e, arm)
        if claim is not None:
            value, low, high, true = claim
            claims += 1
            held += low <= true <= high
            if abs(value - true) > 0.2 * true:
                off.append(f"{e.name} {value:.3g} for {true:.3g}")
    return claims, held, tuple(off)


def claimed(e: Estimate, arm: Arm) -> tuple[float, float, float, float] | None:
    """Value, interval and truth of what an estimate claims; None where it claims nothing, or has no counterpart."""
    joint, _, kind = e.name.rpartition(".")
    if joint not in ("a", "b") or kind not in ("kp", "kv", "damping", "friction", "armature"):
        return None
    place = "ab".index(joint)
    if e.verdict == "identified":
        return e.value, e.low, e.high, float(getattr(arm, kind)[place])
    seen = re.search(r"\+ ([\d.]*)(?: x )?[ab]\.(\w+) is seen: (\S+) \[(\S+), (\S+)\]", e.note)
    if e.verdict == "tied" and seen:
        value, low, high = (float(x) for x in seen.groups()[2:])
        return value, low, high, float(getattr(arm, kind)[place] + float(seen[1] or 1.0) * getattr(arm, seen[2])[place])
    return None


def main() -> None:
    """Prints a line for each arm and the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="six arms")
    parser.add_argument("--arms", type=int, default=50)
    parser.add_argument("--first", type=int, default=0, help="number of the first arm")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    options = parser.parse_args()
    numbers = range(options.first, options.first + (6 if options.quick else options.arms))
    done: list[Count] = []
    with ProcessPoolExecutor(min(options.workers, len(numbers))) as pool:
        for number, one in zip(numbers, pool.map(counted, numbers), strict=True):
            done.append(one)
            print(f"arm {number:3d} {one.structure:9s} {one.held} of {one.claims} held; twins taken as known "
                  f"{one.plain_held} of {one.plain_claims}  {', '.join(one.wrong)}", flush=True)  # fmt: skip
    total = sum(o.claims for o in done)
    plain = sum(o.plain_held for o in done) / sum(o.plain_claims for o in done)
    result("identified_coverage", sum(o.held for o in done) / total, "", 0.95, peer="what was not asked for taken as known",
           peer_value=plain, at_most=False)  # fmt: skip
    result("identified_wrong_by_a_fifth", float(sum(len(o.wrong) for o in done)), f"of {total}", 0.0)


if __name__ == "__main__":
    main()
