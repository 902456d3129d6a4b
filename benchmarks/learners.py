# SPDX-License-Identifier: Apache-2.0
"""The next joint positions of robots, on runs that were not learned from: ten learners, a line, and holding the last value.

Real robots need their recordings (`aliengo` and `so101` in TRUEUP_DATA, or ../shared/data); those absent are left out.
A simulated NAO and a stand-in arm with hidden truths are always there.
"""

from __future__ import annotations

import argparse
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from results import result
from walk_grounding import walked

from trueup import formats
from trueup.evidence import evidence
from trueup.grounding.comparison import Comparison, compare
from trueup.grounding.learn import Learned, Wishes, learn
from trueup.grounding.learners import LEARNERS, learners
from trueup.grounding.rows import inputs_of, rows_of
from trueup.recording import Recording
from trueup.studies.servo_arm.demo import record
from trueup.studies.walk import scenes
from trueup.studies.walk.robot import StandInNao, Truth

ROOT = Path(os.environ.get("TRUEUP_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
QUICK = ("linear", "model-tree", "tree", "neighbours")


def aliengo(quick: bool = False) -> list[Recording]:
    """A quadruped's 26 short runs; none where they are absent."""
    return [formats.read([p])[0] for p in sorted((ROOT / "aliengo").glob("*.csv"))]


def so101(quick: bool = False) -> list[Recording]:
    """A servo arm's 11 motions, each of another kind."""
    folders = sorted(p for p in (ROOT / "so101" / "recordings").glob("*") if p.is_dir())
    return [formats.read([p])[0].replace(name=p.name) for p in folders]


def nao(quick: bool = False) -> list[Recording]:
    """A stand-in for a worn NAO: 16 walks around its start walk, 10 s each, or 6 of 5 s, joints of the legs."""
    robot, rng = StandInNao(Truth.random(np.random.default_rng(0)), threads=1), np.random.default_rng(1)
    runs = walked(robot, rng, *((6, 5.0) if quick else (16, 10.0)), "learn").recordings
    return [r.replace(channels={n: r.channel(n).select(scenes.MOTORS) for n in ("command", "position")}) for r in runs]


def arm(quick: bool = False) -> list[Recording]:
    """A stand-in arm with backlash, Stribeck friction, limited voltage and delay."""
    with tempfile.TemporaryDirectory() as folder:
        return formats.read(sorted(record(Path(folder))))


ROBOTS: dict[str, Callable[[bool], list[Recording]]] = {"nao": nao, "aliengo": aliengo, "so101": so101, "arm": arm}


def show(title: str, found: Comparison) -> None:
    """The paper's table, in both cross-validations."""
    print(f"\n{title}")
    print(f"{'':28s} rows left out    runs left out             a second   fit")
    print(f"{'':28s}  RAE %  RRSE %    RAE %  RRSE %   typical  ahead       s")
    for name, run in found.by_run.items():
        row = found.by_row.get(name)
        by_row = "       -       -" if row is None else f"{100 * row.rae.mean():8.2f}{100 * row.rrse.mean():8.2f}"
        print(f"{LEARNERS[name].weka:27s}{by_row} {100 * run.rae.mean():8.2f}{100 * run.rrse.mean():8.2f} "
              f"{100 * np.exp(np.mean(np.log(run.by_fold))):9.3f}{run.typical:8.3g}{run.seconds:9.2f}")  # fmt: skip
    held = found.held
    print(f"{'hold the last value':44s}{100 * held.rae.mean():8.2f}{100 * held.rrse.mean():8.2f} "
          f"{100 * np.exp(np.mean(np.log(held.by_fold))):9.3f}{held.typical:8.3g}")  # fmt: skip


def main() -> None:
    """Prints two tables a robot (the paper's inputs, the chosen ones), and the RESULT lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="four learners, no rows left out, part of the recordings")
    parser.add_argument("--robots", nargs="+", choices=list(ROBOTS), default=list(ROBOTS))
    parser.add_argument(
        "--budget", type=float, default=100.0, metavar="S", help="CPU s for each table (default: %(default)g)"
    )
    options = parser.parse_args()
    names = QUICK if options.quick else None
    for robot in options.robots:
        recordings = ROBOTS[robot](options.quick)
        if not recordings:
            print(f"{robot}: no recordings (set TRUEUP_DATA to the folder that holds '{robot}')")
            continue
        if options.quick:
            recordings = [r.slice(r.start, r.start + 10.0) for r in recordings if r.duration > 1.0][:12]
        begun = time.process_time()
        if not options.quick:
            plain = rows_of(recordings, inputs_of(recordings, others=()))
            show(f"{robot}: the paper's inputs, {plain.X.shape[1]} in, {plain.Y.shape[1]} out, {len(plain.X)} frames",
                 compare(learners(names), plain, budget=options.budget))  # fmt: skip
        learned = learn(recordings, Wishes(learners=names, by_row=not options.quick, budget=options.budget))
        inputs = learned.grounding.inputs
        show(f"{robot}: chosen inputs ({learned.view} view, {inputs.history} frames)", learned.comparison)
        print(
            f"{learned.grounding.about['learner']}: {learned.grounding.about['why']}; {time.process_time() - begun:.0f} CPU s"
        )
        report(robot, learned)


def report(robot: str, learned: Learned) -> None:
    """The error of what is taken by default over that of a line with the same inputs, and over holding: per run left out."""
    found = learned.comparison
    best, line = learned.score, found.by_run["linear"]
    beside = evidence(line.by_fold, best.by_fold)
    held = evidence(found.held.by_fold, best.by_fold)
    print(f"{robot}: error of {best.name} over linear exp({-beside.gain:.2f} +- {beside.standard_error:.2f})")
    result(f"prediction_over_linear_{robot}", float(np.exp(-beside.gain)), "", 1.0 - 1e-9, peer="linear, same inputs")
    result(f"prediction_over_holding_{robot}", float(np.exp(-held.gain)), "", 1.0 - 1e-9, peer="hold the last value")
    result(f"second_ahead_over_linear_{robot}", best.typical, "spreads", 1.0, peer="linear, same inputs",
           peer_value=line.typical, ratio_goal=True)  # fmt: skip


if __name__ == "__main__":
    main()
