# SPDX-License-Identifier: Apache-2.0
"""`trueup resume`: goes on with a campaign, wherever it was stopped."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console

from trueup.campaign.folder import Folder
from trueup.campaign.journal import set_back
from trueup.campaign.retract import retract
from trueup.commands.console import notes
from trueup.commands.run import add_common, go_on
from trueup.commands.sources import add_shared

ABOUT = """\
Goes on with the campaign in DIR as if it had never been stopped: same proposals, no trial on the robot lost, none
silently repeated. If a trial was under way on hardware when it was stopped, you are asked what became of it.

  trueup resume DIR
  trueup resume DIR --unknown leave     a script's answer: go on without that trial
  trueup resume DIR --retract trial-004 a stop watch was misread, the wrong log was dropped: that run is asked for again, and
                                        so is what was decided on with it; what was there is kept in DIR/retracted-1
  trueup resume DIR --from-line 57      where line 57 of its journal is damaged: go on from the lines before it; the
                                        damaged journal is kept beside it, and so is all that was recorded
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What this command takes."""
    add_shared(parser, "folder")
    parser.add_argument("--retract", metavar="TRIAL", help="take back what became of a run on the robot, as trial-004")
    parser.add_argument("--from-line", type=int, metavar="N", help="forget line N of the journal and all after it")
    add_common(parser)


def run(args: argparse.Namespace, console: Console, told: Console) -> int:
    """Goes on. Raises TrueupError, and KeyboardInterrupt after saying how to go on. Returns the exit code."""
    folder = Folder.open(Path(args.folder))
    if args.retract is not None:
        aside, later = retract(folder.path, args.retract)
        more = f"; so are {', '.join(later)}, decided on with it" if later else ""
        notes(told, [f"{args.retract} is taken back: what was recorded of it is kept in {aside}{more}"])
    if args.from_line is not None:
        aside = set_back(folder.path, args.from_line)
        notes(told, [f"the journal as it was is kept in {aside}"])
    if not folder.events():
        notes(told, ["nothing has begun here: where the plan was mended since, `trueup run` takes it as it is now"])
    return go_on(folder, args, console, told)
