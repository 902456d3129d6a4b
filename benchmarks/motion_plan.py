# SPDX-License-Identifier: Apache-2.0
"""A plan with the task `transition` on hidden robots: the small humanoid's file shall get up from a chair on each of them.

The robots have other servos, masses, friction and delays than the file says, drawn from wide distributions, and noise. Beside
it the sturdiest motion that a search in the file itself finds, three times: what one has without a campaign.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
import zlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from changed_file import changed
from results import result

from trueup.articulated.declarations import Declaration, declare
from trueup.campaign.campaign import Campaign
from trueup.campaign.events import Calibrated, TrialDone
from trueup.campaign.folder import Folder
from trueup.campaign.journal import Journal, read_journal
from trueup.campaign.motions import transition
from trueup.campaign.plan import read_plan, templates
from trueup.campaign.resolve import parts_of
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.loop.confirm import hunt
from trueup.recording import Recording
from trueup.tasks.task import robot_done
from trueup.trial import Trial

PLAN = templates()["motion"] / "campaign.toml"
FILE = PLAN.with_name("small_humanoid.xml")
WEAK = (0.72, 0.67, 2.0, 1.75, 0.8, 1.14, 0.78, -0.01, 0.03)
"""The last robot: weaker all over, with its weight behind, and late. Its first motions fall."""
NOISE = 0.003  # rad and m, of all that is measured


def drawn(number: int) -> tuple[float, ...]:
    """Factors on gains, damping, friction, rotor, force, the torso's mass, the floor's friction; m of balance, s of delay."""
    rng = np.random.default_rng([31, number])
    servos = np.exp(rng.normal(0.0, (0.4, 0.4, 0.6, 0.4, 0.15)))
    return (*servos, *np.exp(rng.normal(0.0, (0.15, 0.2))), 0.01 * rng.standard_normal(), rng.uniform(0.0, 0.05))


class Hidden:
    """A robot that is `wrong` as `drawn` says."""

    repeatable = True

    def __init__(self, wrong: Sequence[float], folder: Path) -> None:
        kp, damping, friction, rotor, force, mass, ground, com, delay = wrong
        model = changed(
            FILE, folder,
            ('damping="0.6"', f'damping="{0.6 * damping}"'), ('frictionloss="0.05"', f'frictionloss="{0.05 * friction}"'),
            ('armature="0.004"', f'armature="{0.004 * rotor}"'), ('kp="25"', f'kp="{25 * kp}"'),
            ('forcerange="-5 5"', f'forcerange="{-5 * force} {5 * force}"'), ('friction="0.9"', f'friction="{0.9 * ground}"'),
            ('mass="1.4"', f'mass="{1.4 * mass}" pos="{com} 0 0"'),
        )  # fmt: skip
        line = Declaration("delay", tie="all", nominal=delay)
        self._simulator = MujocoSimulator(model, *declare(model, [line]), step=0.001)
        self.words = (
            f"kp x {kp:.2f}, damping x {damping:.2f}, force x {force:.2f}, torso x {mass:.2f} and {1e3 * com:+.0f} mm, "
            f"{1e3 * delay:.0f} ms late"
        )

    def perform(self, trial: Trial) -> list[Recording]:
        """See Robot."""
        rng = np.random.default_rng(zlib.crc32(trial.name.encode()))
        return [self._once(name, trial, rng) for name in trial.runs]

    def _once(self, name: str, trial: Trial, rng: np.random.Generator) -> Recording:
        initial = {n: c.replace(values=c.values + 0.003 * rng.standard_normal(c.values.shape)) if n == "position" else c
                   for n, c in trial.initial.items()}  # fmt: skip
        (run,) = self._simulator.rollout(
            [replace(trial, ends=(), initial=initial)], self._simulator.parameters.nominal[None]
        )
        seen = {n: c if n == "command" else c.replace(values=c.values + NOISE * rng.standard_normal(c.values.shape))
                for n, c in run.recording().channels.items()}  # fmt: skip
        return Recording(name, seen)


def by_plan(robot: Hidden, folder: Path) -> tuple[bool, int, int]:
    """Whether the campaign ended with a motion that the robot does, after how many trials and calibrations."""
    begun = Folder.begin(read_plan(PLAN), folder / "out", None)
    parts = replace(parts_of(begun.file, begun.path, lambda line: None), robot=robot)
    with Journal(begun.path) as journal:
        ended = Campaign(begun.file.plan, begun.checksum, "", parts, journal).run()
    events = read_journal(begun.path)
    trials, fits = (sum(isinstance(e, kind) for e in events) for kind in (TrialDone, Calibrated))
    return ended.success, trials, fits


def by_file(robot: Hidden) -> float:
    """Share of three runs in which the robot does the sturdiest motion that is found in the file."""
    simulator, task = transition(FILE, "sit", "stand", between=["lean"])
    winner = hunt(task, simulator, np.random.default_rng(0)).winners[0].values
    trials: Sequence[Trial] = [replace(t, name="file", repeats=3) for t in task.planned(winner)]
    return robot_done(task, [robot.perform(t) for t in trials], winner)


def main() -> None:
    """Prints RESULT lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one robot")
    parser.add_argument("--robots", type=int, default=6, help="the last one is weak; fewer leave out the first")
    options = parser.parse_args()
    rows = []
    robots = [*map(drawn, range(5)), WEAK][-1 if options.quick else -options.robots :]
    for number, wrong in enumerate(robots, 6 - len(robots)):
        with tempfile.TemporaryDirectory() as name:
            robot, began = Hidden(wrong, Path(name)), time.process_time()
            done, trials, fitted = by_plan(robot, Path(name))
            spent, before = time.process_time() - began, by_file(robot)
        rows.append((done, trials, spent, before > 0.5))
        print(f"robot {number} ({robot.words}): {'gets up' if done else 'does not'} after {trials} trials and {fitted} "
              f"calibrations, {spent:.0f} s CPU; by the file's motion in {before:.0%} of three", flush=True)  # fmt: skip
    done, trials, spent, before = (np.array(x, dtype=np.float64) for x in zip(*rows, strict=True))
    result("robots_that_get_up", float(done.mean()), "", 0.9, peer="the sturdiest motion of the file",
           peer_value=float(before.mean()), at_most=False)  # fmt: skip
    result("trials_until_then", float(np.median(trials)), "", 12.0)
    result("plan_cpu_seconds", float(np.median(spent)), "s", 300.0)


if __name__ == "__main__":
    main()
