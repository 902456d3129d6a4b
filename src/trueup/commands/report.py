# SPDX-License-Identifier: Apache-2.0
"""`trueup report`: the story of a campaign as one HTML file."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from trueup.campaign.folder import Folder
from trueup.commands.console import tell
from trueup.commands.sources import add_shared
from trueup.report.campaign import write_campaign_report

ABOUT = """\
Writes the report of the campaign in DIR: what was tried, what the robot did, how the gap closed, and how well the
simulator foretold it. One file that holds all it needs; may be written while the campaign runs.

  trueup report DIR                     into DIR/report.html
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What this command takes."""
    add_shared(parser, "folder")
    parser.add_argument("--out", metavar="FILE", help="where to write (default: DIR/report.html)")


def run(args: argparse.Namespace, console: Console, told: Console) -> int:
    """Writes the report. Raises JournalError where there is no campaign, OutputError. Returns the exit code."""
    folder = Folder.open(Path(args.folder))
    folder.events()  # what was altered is said before anything is told of it
    path = write_campaign_report(folder.path, folder.file.plan, Path(args.out) if args.out else None)
    tell(console, escape(str(path)))
    return 0
