# SPDX-License-Identifier: Apache-2.0
"""`trueup demo`: the whole on a simulated robot, nothing needed."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from trueup.commands.console import tell
from trueup.commands.progress import Watcher
from trueup.commands.show import replay_table
from trueup.commands.study_view import searching, study_table

ABOUT = """\
Shows the whole on a simulated robot whose truth has another structure than its simulator. Takes about a minute.

  trueup demo                    a carrying robot follows its path badly; its simulator is calibrated on that one drive
                                 and the gains of its path follower are tuned in it (the Stanley study)
  trueup demo --robot arm        a servo arm is recorded and its model calibrated from these files alone
  trueup demo --out out/demo     where recordings and report go
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What this command takes."""
    parser.add_argument("--out", default="trueup-demo", metavar="DIR", help="where to write (default: %(default)s)")
    parser.add_argument(
        "--robot", choices=("vehicle", "arm"), default="vehicle", help="which one (default: %(default)s)"
    )


def run(args: argparse.Namespace, console: Console, told: Console) -> int:
    """Runs the demonstration into `args.out`. Returns the exit code."""
    last: list[str] = []

    def say(line: str) -> None:
        """Shows a line at once, but keeps where the report lies for the end."""
        if line.startswith("wrote"):
            last.append(line)
        else:
            tell(console, escape(line))

    if args.robot == "arm":
        from trueup.studies.servo_arm import demo

        with Watcher(told, "rad", quiet=False) as watcher:
            calibration = demo.run(Path(args.out), say, watcher)
        console.print(replay_table(calibration))
    else:
        from trueup.studies.stanley.run import run_study

        with searching(told) as watch:
            study = run_study(Path(args.out), say, told=watch)
        console.print(study_table(study))
    for line in last:
        console.print(escape(line), soft_wrap=True)
    return 0
