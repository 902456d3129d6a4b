# SPDX-License-Identifier: Apache-2.0
"""`trueup run`: a campaign from its plan, to the end or until it is stopped."""

from __future__ import annotations

import argparse
import tempfile
from contextlib import closing
from pathlib import Path
from typing import cast

from rich.console import Console
from rich.markup import escape

from trueup.campaign.folder import Folder
from trueup.campaign.history import History
from trueup.campaign.journal import Journal
from trueup.campaign.plan import PlanFile, read_plan
from trueup.commands.campaign_view import CampaignView, Unknown
from trueup.commands.console import notes, tell
from trueup.commands.sources import add_shared, seed_of
from trueup.commands.status import as_json, show_status
from trueup.commands.where import CLUSTER, add_cluster, evaluator_of
from trueup.extensions import version
from trueup.report.campaign import write_campaign_report

PLAN = "campaign.toml"
"""What `trueup new` calls the plan that it writes."""
ABOUT = (
    """\
Runs a campaign: experiment on the robot, calibrate the simulator, optimize the controller in it, transfer the best to
the robot, validate; round by round, until the robot is good enough or the budget is spent. The plan says all of it;
`trueup new NAME` writes one to edit.

  trueup run                            the campaign.toml of this folder
  trueup run plan.toml --out DIR        into DIR; a campaign of another plan or seed takes DIR-2

Ctrl-C, a power cut or a closed lid are fine: the same command, or `trueup resume DIR`, goes on from there, with the same
proposals. No trial on the robot is lost, and none is repeated unless you say so. In DIR: report.html, the recordings,
for each calibration the model as it was found, its parameters and a report (round-1/calibrated.xml, ...), and
journal.jsonl, which holds everything that was decided.

"""
    + CLUSTER
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What this command takes."""
    parser.add_argument("plan", nargs="?", default=PLAN, metavar="PLAN",
                        help="a plan, or the folder of a campaign.toml (default: %(default)s)")  # fmt: skip
    parser.add_argument("--out", metavar="DIR", help="folder of the campaign (default: the plan's, or its name)")
    parser.add_argument("--seed", type=seed_of, metavar="N", help="of all random numbers (default: the plan's)")
    parser.add_argument("--dry-run", action="store_true",
                        help="make everything that the plan names, say what it is, and stop")  # fmt: skip
    add_common(parser)


def add_common(parser: argparse.ArgumentParser) -> None:
    """What `run` and `resume` share."""
    parser.add_argument("--yes", action="store_true", help="let hardware move without asking each time")
    parser.add_argument("--unknown", choices=("ask", "repeat", "leave"), default="ask",
                        help="what to do about a trial that was interrupted on hardware (default: %(default)s)")  # fmt: skip
    add_cluster(parser)
    add_shared(parser, "json", "quiet")


def run(args: argparse.Namespace, console: Console, told: Console) -> int:
    """Runs the plan. Raises TrueupError, and KeyboardInterrupt after saying how to go on. Returns the exit code."""
    plan = Path(args.plan)
    file = read_plan(plan / PLAN if plan.is_dir() else plan)
    if args.dry_run:
        return _describe_parts(file, console)
    folder = Folder.begin(file, Path(args.out) if args.out else None, args.seed)
    if folder.ended:
        notes(told, [folder.note], quiet=args.quiet)
        return told_outcome(folder, args, console)
    return go_on(folder, args, console, told)


def _describe_parts(file: PlanFile, console: Console) -> int:
    """Makes all parts of a plan, and says what they are."""
    from trueup.campaign.rehearsal import require_within_limits
    from trueup.campaign.resolve import parts_of

    with tempfile.TemporaryDirectory() as folder:
        parts = parts_of(file, Path(folder), lambda _line: None)
        require_within_limits(parts)
        free = [p.name for p in parts.task.parameters.parameters if not p.frozen]
        fitted = [p.name for p in parts.simulator.parameters.parameters if not p.frozen]
        for line in (
            f"{file.path}: the plan of '{file.plan.name}' can be run",
            f"robot       {file.plan.robot.type}",
            f"simulator   {parts.simulator.name}, calibrates: {', '.join(fitted) or 'nothing'}",
            f"task        {parts.task.name}, tunes: {', '.join(free)}",
            f"recordings  {', '.join(r.name for r in (*parts.recordings, *parts.held_out)) or 'none yet'}",
        ):
            tell(console, escape(line))
    return 0


def go_on(folder: Folder, args: argparse.Namespace, console: Console, told: Console) -> int:
    """Runs the campaign in `folder` from wherever it is."""
    from trueup.campaign.campaign import Campaign  # with all that a calibration needs: --help must not wait for it
    from trueup.campaign.resolve import parts_of

    notes(told, [folder.note] if folder.note else [], quiet=args.quiet)

    def say(line: str) -> None:
        if not args.quiet:
            tell(told, f"  {escape(line)}")

    unknown, plan = cast(Unknown, args.unknown), folder.file.plan
    with Journal(folder.path) as journal:
        view = CampaignView(told, plan, folder.path, quiet=args.quiet, yes=args.yes, unknown=unknown)
        where = args.cluster or plan.evaluate.cluster, args.quorum or plan.evaluate.quorum
        try:
            with closing(evaluator_of(*where, told, quiet=args.quiet, watch=view.simulated)) as evaluator, view:
                parts = parts_of(folder.file, folder.path, say, evaluator, journal.past)
                Campaign(plan, folder.checksum, version(), parts, journal, view).run()
        except KeyboardInterrupt:
            told.print(
                f"stopped; everything is kept. To go on: trueup resume {escape(str(folder.path))}", soft_wrap=True
            )
            raise KeyboardInterrupt("how to go on was said") from None
    return told_outcome(folder, args, console)


def told_outcome(folder: Folder, args: argparse.Namespace, console: Console) -> int:
    """Writes the report, shows the outcome, and where that and the model last calibrated are."""
    report = write_campaign_report(folder.path, folder.file.plan)
    history = History.of(folder.events())
    if args.json:
        console.print_json(as_json(history))
        return 0
    show_status(history, folder.file.plan, console)
    fits = [r.calibrated.round for r in history.rounds if r.calibrated is not None]
    models = sorted(folder.path.glob(f"round-{fits[-1]}/calibrated*.*")) if fits else []
    for written in (report, *models):
        tell(console, f"  {escape(str(written))}")
    return 0
