# SPDX-License-Identifier: Apache-2.0
"""Runs the study: `python -m trueup.studies.balance --out out/study-balance`, an hour; `--quick` some minutes."""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from trueup.errors import TrueupError
from trueup.formats.aside import write_aside
from trueup.studies.balance.plan import SCENES, Size
from trueup.studies.balance.report import html
from trueup.studies.balance.study import QUICK, studied
from trueup.studies.progress import telling


def main() -> int:
    """Writes report.html and parts of the results into the folder given; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m trueup.studies.balance", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/study-balance"), help="folder of the results")
    parser.add_argument("--quick", action="store_true", help="three stand-ins, two tasks, nothing beside them")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, help="only these tasks")
    parser.add_argument("--stand-ins", type=int, help="how many robots (10); a folder may be gone on with by more")
    parser.add_argument("--first", type=int, help="number of the first of them (0)")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)), help="processes (one a core)")
    parser.add_argument("--seed", type=int, default=0, help="of the searches; the stand-ins' truths are fixed")
    parser.add_argument(
        "--oracle", type=int, help="runs that a search on the robot itself may take (24; 0: none is made)"
    )
    parser.add_argument("--subsets", type=int, help="stand-ins for the paper's Table I (2)")
    parser.add_argument("--report", action="store_true", help="compute nothing: report what is in the folder already")
    asked = parser.parse_args()
    size = QUICK if asked.quick else Size()
    given = {k: getattr(asked, k) for k in ("stand_ins", "first", "oracle", "subsets") if getattr(asked, k) is not None}
    depth = replace(size.depth, seed=asked.seed)
    size = replace(size, scenes=tuple(asked.scenes or size.scenes), depth=depth, **given)
    told = Console(stderr=True)
    try:
        with telling(told, "searching the first motions") as tell:
            findings = studied(asked.out, size, tell, compute=not asked.report, workers=asked.workers)
        write_aside(html(findings), asked.out / "report.html")
    except TrueupError as error:
        told.print(str(error), style="red", markup=False)
        return 2
    except KeyboardInterrupt:
        told.print("stopped; the same command goes on with what is not there yet", markup=False)
        return 130
    for scene in findings.campaigns:
        words = ", ".join(f"{100 * findings.share(scene, k):.0f} % after {k}" for k in range(size.depth.rounds + 1))
        Console().print(f"{scene}: works on {words} calibrations", markup=False, soft_wrap=True)
    Console().print(f"report: {asked.out / 'report.html'}", soft_wrap=True, markup=False)
    return 0


if __name__ == "__main__":
    sys.exit(main())
