# SPDX-License-Identifier: Apache-2.0
"""The plan `trueup new --from walk` on hidden bipeds: other servos, masses and delays than the template's file says.

None of them is the NAO from whose stand-ins the plan's priors come: another size, other legs. What is handed over is judged
by fresh runs, beside the walk with which the plan begins.
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
from numpy.typing import NDArray
from results import result

from trueup.articulated.declarations import Declaration, declare
from trueup.campaign.campaign import Campaign
from trueup.campaign.folder import Folder
from trueup.campaign.history import History
from trueup.campaign.journal import Journal, read_journal
from trueup.campaign.parts import Parts
from trueup.campaign.plan import read_plan, templates
from trueup.campaign.resolve import parts_of
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.recording import Recording
from trueup.tasks.task import as_rollout, robot_tally, robot_trials
from trueup.tasks.walking import LineWalk, fell
from trueup.trial import Trial
from trueup.watched_run import WatchedRun

PLAN = templates()["walk"] / "campaign.toml"
FILE = PLAN.with_name("biped.xml")
REACTION = 0.1  # s, deviation of times taken by hand, which are rounded to as much
ZERO = 0.008  # rad by which the zeros of joints are off, one deviation
JOINTS = ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle_pitch", "ankle_roll")
SIDES = [f"{s}_{j}" for s in ("left", "right") for j in JOINTS]


class Hidden:
    """Biped `number`: gains, damping, friction, rotors, mass and balance drawn about the file's, zeros off, late."""

    repeatable = True
    watched = False
    """Of its runs nobody knows more than a stop watch and eyes tell."""

    def __init__(self, number: int, task: LineWalk, folder: Path) -> None:
        rng = np.random.default_rng([47, number])
        kp, kv, friction, rotor, mass = np.exp(rng.normal(0.0, (0.25, 0.3, 0.4, 0.3, 0.1)))
        com, delay = 0.005 * rng.standard_normal(), rng.uniform(0.0, 0.02)
        model = changed(
            FILE, folder,
            ('kp="110" kv="1.5"', f'kp="{110 * kp}" kv="{1.5 * kv}"'),
            ('frictionloss="0.06"', f'frictionloss="{0.06 * friction}"'), ('armature="0.008"', f'armature="{0.008 * rotor}"'),
            ('pos="0 0 -0.02" size="0.05 0.075 0.1" mass="1.9"',
             f'pos="{com} 0 -0.02" size="0.05 0.075 0.1" mass="{1.9 * mass}"'),
        )  # fmt: skip
        lines = [Declaration("delay", tie="all", nominal=delay)]
        lines += [Declaration("zero", (j,), nominal=float(ZERO * rng.standard_normal())) for j in SIDES]
        self._simulator = MujocoSimulator(model, *declare(model, lines), step=0.005)
        self._task, self._number = task, number
        self.words = f"kp x {kp:.2f}, torso x {mass:.2f} and {1e3 * com:+.0f} mm, {1e3 * delay:.0f} ms late"

    def perform(self, trial: Trial) -> list[Recording]:
        """See Robot."""
        rng = np.random.default_rng([self._number, zlib.crc32(trial.name.encode())])
        rows = np.tile(self._simulator.parameters.nominal, (trial.repeats, 1))
        values = np.tile(list(trial.settings.values()), (trial.repeats, 1))
        own = replace(trial, disturbances=self._task.disturbances, sensing=self._task.sensing).seeded(rng)
        (done,) = self._simulator.rollout([own], np.hstack([rows, values]), self._task.controllers)
        names = [trial.name] if trial.repeats == 1 else [f"{trial.name}-{k + 1}" for k in range(trial.repeats)]
        logs = [done.recording(k).replace(name=name) for k, name in enumerate(names)]
        return [seen(self._task, trial, log, rng).recording(trial) if self.watched else log for log in logs]


def seen(task: LineWalk, trial: Trial, log: Recording, rng: np.random.Generator) -> WatchedRun:
    """What people tell of a run: times taken by hand, and to which side it lay."""
    rollout = as_rollout(trial, [log])
    lasted = task.line / np.array(task.speeds(rollout)[0])
    times = np.round(np.cumsum(lasted) + REACTION * rng.standard_normal(len(lasted)), 1)
    down, over = bool(fell(rollout)[0]), len(times) == task.laps
    roll, pitch = log.channel("base_orientation").values[-1, :2]
    side = ("forward" if pitch > 0.0 else "backward") if abs(pitch) > abs(roll) else ("right" if roll > 0.0 else "left")
    veered = not over and not down and bool(rollout.ends)
    return WatchedRun(
        tuple(times.tolist()), fell=side * (down and not over), veered=veered, late=not (over or down or veered)
    )


def by_plan(number: int, text: str, folder: Path, watched: bool) -> tuple[Hidden, Parts, History]:
    """The campaign of a robot, to its end."""
    for file in PLAN.parent.iterdir():
        (folder / file.name).write_text(file.read_text("utf-8"), encoding="utf-8")
    (folder / "campaign.toml").write_text(text, encoding="utf-8")
    begun = Folder.begin(read_plan(folder / "campaign.toml"), folder / "out", None)
    parts = parts_of(begun.file, begun.path, lambda line: None)
    assert isinstance(parts.task, LineWalk)
    robot = Hidden(number, parts.task, folder)
    robot.watched = watched
    with Journal(begun.path) as journal:
        Campaign(begun.file.plan, begun.checksum, "", replace(parts, robot=robot), journal).run()
    robot.watched = False
    return robot, parts, History.of(read_journal(begun.path))


def judged(robot: Hidden, task: LineWalk, values: Sequence[float], fresh: int) -> tuple[float, float]:
    """m/s of single runs to the line that arrive, and the share of those that fall or veer."""
    single = replace(task, laps=1)
    (trial,) = robot_trials(single, np.array(values), " fresh")
    tally: NDArray[np.float64] = robot_tally(single, [robot.perform(replace(trial, repeats=fresh))])
    arrived, ended = tally[:, 0].sum(), tally[:, 2:].sum()
    return float(np.exp(tally[:, 1].sum() / max(arrived, 1.0))), float(ended / (arrived + ended))


def main() -> None:
    """Prints RESULT lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one robot, fewer fresh runs")
    parser.add_argument("--robots", type=int, default=6)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--laps", type=int, default=3)
    parser.add_argument("--watched", action="store_true", help="judged by a stop watch and eyes, not by poses")
    options = parser.parse_args()
    text = PLAN.read_text("utf-8").replace("# laps = 1 ", f"laps = {options.laps} ")
    rows, fresh = [], 40 if options.quick else 100
    for number in range(options.first, options.first + (1 if options.quick else options.robots)):
        with tempfile.TemporaryDirectory() as name:
            began = time.process_time()
            robot, parts, history = by_plan(number, text, Path(name), options.watched)
            spent, task = time.process_time() - began, parts.task
            assert isinstance(task, LineWalk)
            before, after = (judged(robot, task, v, fresh) for v in
                             (task.parameters.nominal.tolist(), list(history.best[0].values())))  # fmt: skip
        trials = sum(t.planned.repeats for t in history.trials)
        rows.append((after[0] / before[0] - 1.0, before[1], after[1], trials, spent))
        ended = history.rounds[-1].ended
        assert ended is not None
        share, low, high = (fresh * x for x in ended.early)
        print(
            f"robot {number} ({robot.words}): {100 * before[0]:.1f} -> {100 * after[0]:.1f} cm/s, falls in {fresh}: "
            f"{fresh * before[1]:.0f} -> {fresh * after[1]:.0f} (the report expects {share:.1f}, {low:.1f} to {high:.1f}), "
            f"{trials} trials, {spent:.0f} s CPU",
            flush=True,
        )
    gain, before_falls, falls, trials_each, cpu = np.array(rows).T
    result("own_biped_gain_percent", float(100 * np.median(gain)), "%", 26.7, at_most=False)
    result("own_biped_falls_in_100", float(100 * np.median(falls)), "", 3.0, peer="the walk it begins with",
           peer_value=float(100 * np.median(before_falls)))  # fmt: skip
    result("own_biped_slower", float(np.sum(gain < 0.0)), f"of {len(rows)}", 0.0)
    result("own_biped_trials", float(np.max(trials_each)), "", 60.0)
    result("own_biped_cpu_seconds", float(np.median(cpu)), "s", 300.0)


if __name__ == "__main__":
    main()
