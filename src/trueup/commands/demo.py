# SPDX-License-Identifier: Apache-2.0
"""`trueup demo`: the whole on a simulated arm, nothing needed."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from trueup.commands.progress import Watcher


def run(args: argparse.Namespace, console: Console, told: Console) -> int:
    """Runs the demonstration into `args.out`. Returns the exit code."""
    from trueup import demo

    with Watcher(told, "rad", quiet=False) as watcher:
        demo.run(Path(args.out), lambda line: console.print(escape(line), soft_wrap=True), watcher)
    return 0
