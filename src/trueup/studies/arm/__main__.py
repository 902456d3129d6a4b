# SPDX-License-Identifier: Apache-2.0
"""Runs the study: `python -m trueup.studies.arm --out out/study-arm`, eight minutes of one core; `--quick` half of one."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from trueup.errors import OutputError
from trueup.studies.arm.study import FULL, QUICK, performed
from trueup.studies.progress import telling


def main() -> int:
    """Writes report.html, report.md and cells.json into the folder given; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m trueup.studies.arm", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/study-arm"), help="folder of the results")
    parser.add_argument("--quick", action="store_true", help="one region, few excitations and tests")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    console, told = Console(), Console(stderr=True)
    scale = replace(QUICK if options.quick else FULL, seed=options.seed)
    regions = ("B",) if options.quick else ("B", "A", "C")
    try:
        with telling(told, "designing excitations") as tell:
            shares = performed(options.out, scale, tell, regions)
    except OutputError as error:
        told.print(str(error), style="red", markup=False)
        return 2
    except KeyboardInterrupt:
        told.print("stopped; the same command goes on with what is not there yet", markup=False)
        return 130
    for name, share in shares.items():
        console.print(f"region {name}: ours is best, or not surely worse, in {100 * share:.0f} % of cells")
    console.print(f"report: {options.out / 'report.html'}", soft_wrap=True, markup=False)
    return 0


if __name__ == "__main__":
    sys.exit(main())
