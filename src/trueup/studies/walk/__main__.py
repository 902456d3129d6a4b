# SPDX-License-Identifier: Apache-2.0
"""Runs the study: `python -m trueup.studies.walk --out out/study-walk`, two minutes of a core for each robot and seed."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from trueup.errors import RenderingError, TrueupError
from trueup.studies.walk.comparison import FULL, PAPER, QUICK, Result, performed, summary
from trueup.studies.walk.film import strip
from trueup.studies.walk.robot import StandInNao
from trueup.studies.walk.study import Ungrounded


def main() -> int:
    """Writes results.json and a film strip into the folder given; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m trueup.studies.walk", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/study-walk"), help="folder of the results")
    parser.add_argument("--robots", type=int, help="how many stand-ins (default 8; 1 with --quick)")
    parser.add_argument("--seeds", type=int, help="searches on each (default 5; 1 with --quick)")
    parser.add_argument("--quick", action="store_true", help="short searches on one stand-in: half a minute, and rough")
    parser.add_argument("--paper", action="store_true", help="150 candidates a generation, 7 runs of 15 s each: hours")
    asked = parser.parse_args()
    console, scale = Console(), QUICK if asked.quick else PAPER if asked.paper else FULL
    method = Ungrounded(runs=7, seconds=15.0) if asked.paper else Ungrounded()
    robots, seeds = asked.robots or (1 if asked.quick else 8), asked.seeds or (1 if asked.quick else 5)
    try:
        asked.out.mkdir(parents=True, exist_ok=True)
        results = []
        for result in performed(method, scale, range(robots), range(seeds), lambda text: console.print(text)):
            results.append(result)
            kept = json.dumps([asdict(r) for r in results], indent=1, default=list)
            (asked.out / "results.json").write_text(kept, encoding="utf-8")
    except (TrueupError, OSError) as error:
        Console(stderr=True).print(str(error), style="red", markup=False)
        return 2
    except KeyboardInterrupt:
        Console(stderr=True).print(f"stopped; what was found so far is in {asked.out / 'results.json'}", markup=False)
        return 130
    console.print(_table(results))
    for line in summary(results):
        console.print(line)
    best = max(results, key=lambda r: r.gain)
    try:
        robot = StandInNao(best.truth(), log=50.0)
        walks = {f"start walk, steps of {100 * best.start_share:.0f} %": (best.start(), best.start_share),
                 f"after two rounds, {100 * best.speed:.1f} cm/s": (best.final(), scale.share)}  # fmt: skip
        console.print(f"film: {strip(robot, walks, asked.out / 'film.svg')}", soft_wrap=True, markup=False)
    except RenderingError as error:
        console.print(str(error), markup=False)
    return 0


def _table(results: list[Result]) -> Table:
    table = Table(
        "robot", "seed", "start, cm/s (step)", "found, cm/s", "gain, %", "falls in 100", "trials", "robot time, min"
    )
    for r in results:
        table.add_row(
            str(r.robot), str(r.seed), f"{100 * r.start_speed:.1f} ({100 * r.start_share:.0f} %)", f"{100 * r.speed:.1f}",
            f"{100 * r.gain:.0f}", f"{100 * r.falls:.0f}", str(r.trials), f"{r.seconds / 60:.1f}",
        )  # fmt: skip
    return table


if __name__ == "__main__":
    sys.exit(main())
