# SPDX-License-Identifier: Apache-2.0
"""`trueup resume`: goes on with a campaign, wherever it was stopped."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console

from trueup.campaign.folder import Folder
from trueup.commands.run import add_common, go_on

ABOUT = """\
Goes on with the campaign in DIR as if it had never been stopped: same proposals, no trial on the robot lost, none
silently repeated. If a trial was under way on hardware when it was stopped, you are asked what became of it.

  trueup resume DIR
  trueup resume DIR --unknown leave     a script's answer: go on without that trial
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What this command takes."""
    parser.add_argument(
        "folder", nargs="?", default=".", metavar="DIR", help="the campaign's folder (default: this one)"
    )
    add_common(parser)


def run(args: argparse.Namespace, console: Console, told: Console) -> int:
    """Goes on. Raises TrueupError, and KeyboardInterrupt after saying how to go on. Returns the exit code."""
    return go_on(Folder.open(Path(args.folder)), args, console, told)
