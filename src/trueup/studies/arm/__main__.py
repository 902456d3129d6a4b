# SPDX-License-Identifier: Apache-2.0
"""Runs the study: `python -m trueup.studies.arm --out out/study-arm`; half an hour of one core, `--quick` a minute."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from trueup.studies.arm.study import FULL, QUICK, performed


def main() -> None:
    """Writes report.html, report.md and cells.json into the folder given."""
    parser = argparse.ArgumentParser(prog="python -m trueup.studies.arm", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/study-arm"), help="folder of the results")
    parser.add_argument("--quick", action="store_true", help="one region, few excitations and tests")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    console, told = Console(), Console(stderr=True)
    scale = replace(QUICK if options.quick else FULL, seed=options.seed)
    regions = ("B",) if options.quick else ("B", "A", "C")
    for name, share in performed(options.out, scale, told.print, regions).items():
        console.print(f"region {name}: ours is best, or not surely worse, in {100 * share:.0f} % of cells")
    console.print(f"report: {options.out / 'report.html'}")


if __name__ == "__main__":
    main()
