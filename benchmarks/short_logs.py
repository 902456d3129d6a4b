# SPDX-License-Identifier: Apache-2.0
"""Is what is called 'identified' so on short logs? The servo arms of `verdicts` on one or two logs of 2, 3 or 5 s.

Each has one kind of motion (steps, a chirp, slow sines, or both) and one structure that the file does not say: none, a
punch, a spring, a gear that twists, backlash, friction of other forms, a dead band, a force limit that is met, or a limit
of the commands' acceleration. What counts is what `verdicts` counts, and force limits. The control is the same
calibration without what rival structures would make of the estimates (`loop/rivals.py`).
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from results import result
from verdicts import GEAR, Arm, claimed

from trueup.arrays import Array
from trueup.calibration import Estimate
from trueup.loop import calibrate as loop_calibrate
from trueup.loop.calibrate import Options
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording
from trueup.trial import Trial

STRUCTURES = (
    "none", "punch", "spring", "elastic", "backlash", "friction", "dead_band", "limit", "none", "acceleration"
)  # fmt: skip
MOTIONS = "steps", "chirp", "sines", "mixed"
SECONDS = 2.0, 3.0, 5.0
NOISES = 1e-4, 3e-4, 1e-3  # rad
LINE = '[[parameter]]\nquantity = "{}"\nof = "{}"\nnominal = {}\n'
Estimates = tuple[Estimate, ...]
FAR = 0.2  # share of the truth


@dataclass(frozen=True)
class Short:
    """A robot and how it was logged."""

    structure: str
    motion: str
    seconds: float
    noise: float
    runs: int
    arm: Arm
    file: Arm

    @classmethod
    def drawn(cls, number: int, rng: np.random.Generator) -> Short:
        """The robot of a number: structures in turn, motions and lengths so that all meet."""
        structure = STRUCTURES[number % len(STRUCTURES)]
        lap = number // len(STRUCTURES)
        noise, arm = NOISES[rng.integers(3)], Arm.drawn(rng)
        if structure == "limit":
            arm = replace(arm, limit=float(rng.uniform(4, 10)))
        file = arm.mistaken(rng)
        if structure == "limit":
            file = replace(file, limit=arm.limit * float(2.0 ** rng.uniform(-1, 1)))
        motion, seconds = MOTIONS[(number + lap) % 4], SECONDS[(number + lap) % 3]
        return cls(structure, motion, seconds, noise, int(rng.integers(1, 3)), arm, file)

    def hidden(self) -> str:
        """What the arm has and MJCF has no place for, as lines of a parameters file."""
        more = {
            "punch": {"punch": [0.02 * k for k in self.arm.kp]},
            "spring": {"spring": [0.25 * k for k in self.arm.kp], "spring_rest": [0.2, 0.2]},
            "friction": {"friction_static": [0.1, 0.1], "friction_load": [0.08, 0.08]},
            "dead_band": {"dead_band": [0.02, 0.02]},
            "acceleration": {"acceleration_limit": [40.0, 40.0]},
        }.get(self.structure, {})
        return "".join(LINE.format(q, j, v) for q, both in more.items() for j, v in zip("ab", both, strict=True))

    def told(self, run: int, time: Array, rng: np.random.Generator) -> Array:
        """(T, 2) commands of a run."""
        motion = self.motion if self.motion != "mixed" else ("steps", "sines")[run]
        if motion == "steps":
            count = max(2, round(time[-1] / 0.8))
            command = rng.uniform(-0.5, 0.5, (count, 2))[
                np.minimum(np.arange(len(time)) * count // len(time), count - 1)
            ]
        elif motion == "chirp":
            swept = 2.0 * np.pi * (0.3 * time + (rng.uniform(2.0, 4.0) - 0.3) * time**2 / (2.0 * time[-1]))
            command = 0.25 * np.stack([np.sin(swept), np.sin(0.8 * swept + 1.0)], axis=1)
        else:
            rates, phases = rng.uniform(0.3, 0.7, 2), rng.uniform(0.0, 6.3, 2)
            command = 0.4 * np.sin(2.0 * np.pi * rates * time[:, None] + phases)
        return np.asarray(command * np.clip(time[:, None] / 0.2, 0.0, 1.0))

    def logs(self, folder: Path, rng: np.random.Generator) -> list[Recording]:
        """What the arm was sent and where its encoders say it went."""
        truth, lines = folder / "truth.xml", folder / "hidden.toml"
        truth.write_text(self.arm.text(self.structure if self.structure in GEAR else "none"))
        lines.write_text(self.hidden())
        robot = prepare(truth, (), parameters=lines if self.hidden() else None, propose=False).simulator
        time, logs = np.arange(0.0, self.seconds, 0.01), []
        for run in range(self.runs):
            sent = Channel("command", ("a", "b"), "rad", time, self.told(run, time, rng))
            still = sent.replace(name="position", values=np.zeros_like(sent.values))
            plan = Recording(f"{self.motion} {run}", {"command": sent, "position": still})
            (seen,) = robot.rollout([Trial.of(plan)], robot.parameters.nominal[None])
            measured = seen.channels["position"][0] + rng.normal(0.0, self.noise, still.values.shape)
            logs.append(plan.with_channel(still.replace(values=measured)))
        return logs


@dataclass(frozen=True)
class Count:
    """Of what is called identified: how much there is, how much of it is held, and what is off by more than `FAR`."""

    claims: int = 0
    held: int = 0
    off: tuple[str, ...] = ()

    @classmethod
    def of(cls, estimates: tuple[Estimate, ...], arm: Arm) -> Count:
        """What these claim of an arm."""
        every = [(e.name, c) for e in estimates if (c := _claimed(e, arm)) is not None]
        off = tuple(f"{n} {v:.3g} for {t:.3g}" for n, (v, _, _, t) in every if abs(v - t) > FAR * t)
        return cls(len(every), sum(low <= true <= high for _, (_, low, high, true) in every), off)

    def __add__(self, other: Count) -> Count:
        return Count(self.claims + other.claims, self.held + other.held, self.off + other.off)


def _claimed(e: Estimate, arm: Arm) -> tuple[float, float, float, float] | None:
    if e.name.endswith(".force_limit"):
        return (e.value, e.low, e.high, arm.limit) if e.verdict == "identified" else None
    return claimed(e, arm)


def counted(number: int) -> tuple[Short, Count, Count]:
    """One robot: what is claimed, and what would be without rivals."""
    rng = np.random.default_rng([number, 20261125])
    robot = Short.drawn(number, rng)
    with tempfile.TemporaryDirectory() as folder:
        logs = robot.logs(Path(folder), rng)
        (file := Path(folder) / "arm.xml").write_text(robot.file.text())
        found, plain = _both(file, logs)
    return robot, Count.of(found, robot.arm), Count.of(plain, robot.arm)


def _both(file: Path, logs: Sequence[Recording]) -> tuple[Estimates, Estimates]:
    """Estimates of a calibration, and those that the same fit would give without rivals."""
    findings, kept = loop_calibrate._findings, list[Estimates]()

    def twice(*given: Any) -> dict[str, Any]:
        with patch.object(loop_calibrate, "rivals", lambda problem, fit: ()):
            kept.append(findings(*given)["estimates"])
        return findings(*given)

    with patch.object(loop_calibrate, "_findings", twice):
        found = prepare(file, logs).calibrate(Options(cross_validate=False))
    return found.estimates, kept[0]


def main() -> None:
    """Prints a line for each robot and the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="ten robots")
    parser.add_argument("--robots", type=int, default=30)
    parser.add_argument("--first", type=int, default=0, help="number of the first robot")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    options = parser.parse_args()
    numbers = range(options.first, options.first + (10 if options.quick else options.robots))
    total, plain = Count(), Count()
    simple, simple_plain = Count(), Count()
    with ProcessPoolExecutor(min(options.workers, len(numbers))) as pool:
        for number, (robot, one, control) in zip(numbers, pool.map(counted, numbers), strict=True):
            total, plain = total + one, plain + control
            if robot.structure == "none":
                simple, simple_plain = simple + one, simple_plain + control
            logs = f"{robot.runs} x {robot.seconds:.0f} s {robot.motion}"
            print(f"robot {number:3d} {robot.structure:12s} {logs:13s} {one.held} of {one.claims} held; without rivals "
                  f"{control.held} of {control.claims}, {len(control.off)} far off  {', '.join(one.off)}",
                  flush=True)  # fmt: skip
    result("short_identified_coverage", total.held / max(total.claims, 1), "", 0.9, peer="without rival structures",
           peer_value=plain.held / max(plain.claims, 1), at_most=False)  # fmt: skip
    result("short_wrong_by_a_fifth", len(total.off) / max(total.claims, 1), f"of {total.claims}", 0.05,
           peer="without rival structures", peer_value=len(plain.off) / max(plain.claims, 1))  # fmt: skip
    result("short_claims_kept_without_a_structure", simple.claims / max(simple_plain.claims, 1), f"of {simple_plain.claims}",
           0.8, at_most=False)  # fmt: skip


if __name__ == "__main__":
    main()
