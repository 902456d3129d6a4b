# SPDX-License-Identifier: Apache-2.0
"""`trueup demo`: the whole on a simulated arm, nothing needed."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from trueup.commands.progress import Watcher
from trueup.commands.show import replay_table

ABOUT = """\
Records a simulated arm whose truth has another structure than its model (Stribeck friction, backlash, delay, encoder
grid), calibrates the model from these files alone, and writes recordings and report. Takes about a minute.

  trueup demo --out out/demo
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What this command takes."""
    parser.add_argument("--out", default="trueup-demo", metavar="DIR", help="where to write (default: %(default)s)")


def run(args: argparse.Namespace, console: Console, told: Console) -> int:
    """Runs the demonstration into `args.out`. Returns the exit code."""
    from trueup import demo

    last: list[str] = []

    def say(line: str) -> None:
        """Shows a line at once, but keeps where the report lies for the end."""
        if line.startswith("wrote"):
            last.append(line)
        else:
            console.print(escape(line), soft_wrap=True)

    with Watcher(told, "rad", quiet=False) as watcher:
        calibration = demo.run(Path(args.out), say, watcher)
    console.print(replay_table(calibration))
    for line in last:
        console.print(escape(line), soft_wrap=True)
    return 0
