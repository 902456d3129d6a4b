# SPDX-License-Identifier: Apache-2.0
"""`trueup new`: a folder with a commented plan, to edit and run."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from trueup.campaign.journal import keep_text
from trueup.campaign.plan import templates
from trueup.errors import OutputError, unknown_name

ABOUT = """\
Makes the folder NAME with a commented campaign.toml to edit, and the files that it needs. Nothing is overwritten.

  trueup new floor-tuning                    a blank plan; every key explained
  trueup new floor-tuning --from stanley     a wheeled robot that follows a path, driven by hand
  trueup new get-up --from motion            a humanoid that stands up: poses of your MJCF, searched, tried, calibrated
  trueup new faster --from walk              a biped that walks faster: its pace and lean, found on the robot
  cd floor-tuning && trueup run
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What this command takes."""
    parser.add_argument("name", metavar="NAME", help="folder to make")
    parser.add_argument(
        "--from", dest="template", default="blank", metavar="PLAN", help="what to begin with (default: blank)"
    )


def run(args: argparse.Namespace, console: Console, told: Console) -> int:
    """Writes the folder. Raises UnknownNameError for another template, OutputError where NAME exists."""
    known = templates()
    if args.template not in known:
        raise unknown_name("plan", args.template, known, "what trueup can begin with")
    folder = Path(args.name)
    if folder.exists() and any(folder.iterdir() if folder.is_dir() else [folder]):
        raise OutputError(f"'{folder}' exists already; name another folder")
    source = known[args.template]
    for file in sorted(f for f in source.iterdir() if f.is_file()):
        keep_text(folder / file.name, file.read_text(encoding="utf-8").replace("NAME", folder.name))
    console.print(escape(f"{folder}/campaign.toml is yours to edit; then: cd {folder} && trueup run"), soft_wrap=True)
    return 0
