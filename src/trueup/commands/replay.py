# SPDX-License-Identifier: Apache-2.0
"""`trueup replay`: how well a model replays recordings as it is, or two models side by side. Nothing is fitted."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from trueup.calibration import Replay, pooled_rmse
from trueup.campaign.output import free_folder
from trueup.commands.replay_drives import drive_table, plain_drive, write_drives
from trueup.commands.sources import (
    STEP,
    add_refuse,
    mapping_for,
    readable,
    recordings_in,
    refusable,
    step_of,
    while_driven,
)
from trueup.formats.plain import finite
from trueup.report import replay_picture
from trueup.report.numbers import ratio_text, scale_for
from trueup.report.writing import write_aside

if TYPE_CHECKING:
    from trueup.loop.prepare import Comparison
    from trueup.recording import Recording

ABOUT = """\
Replays recordings in a model (MJCF or URDF, or a car's TOML file) as it is and shows how far it is from them, joint by
joint. Nothing is fitted: it judges a model on new recordings, tells whether the robot has changed since it was calibrated,
and puts two models side by side. A car is predicted 1 s and 3 s ahead, again and again.

  trueup replay robot.xml logs/*.csv
  trueup replay fit/robot.xml new/*.csv --against robot.xml --out compared
  trueup replay robot.xml new/*.csv --parameters fit/parameters.toml    with what an MJCF cannot say (sensor errors, ...)
  trueup replay fit/car.toml new_drives/*.csv --out predicted
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What this command takes."""
    parser.add_argument("model", metavar="MODEL", help="MJCF or URDF of the robot, or a car's TOML file")
    parser.add_argument("recordings", nargs="+", metavar="RECORDING", help="files or folders")
    parser.add_argument(
        "--parameters", metavar="FILE", help="values to apply (TOML), as `trueup calibrate` writes them"
    )
    parser.add_argument("--against", metavar="MODEL", help="another model to compare with (default with --parameters: "
                        "MODEL without them)")  # fmt: skip
    parser.add_argument("--mapping", metavar="FILE", help="how columns become channels (default: mapping.toml if here)")
    parser.add_argument("--channels", metavar="LIST", help="measured channels to compare, with commas (default: "
                        "position, or whatever there is)")  # fmt: skip
    parser.add_argument("--step", type=step_of, metavar="S", help=f"integration step in s (default: {STEP})")
    add_refuse(parser)
    parser.add_argument("--out", metavar="DIR", help="folder for a picture of each recording; the next run takes DIR-2")
    parser.add_argument("--json", action="store_true", help="print the errors as JSON, for scripts")
    parser.add_argument("-q", "--quiet", action="store_true", help="no notes")


def run(args: argparse.Namespace, console: Console, told: Console) -> int:
    """Replays, shows a table, writes pictures if asked. Raises TrueupError. Returns the exit code."""
    paths, notes = readable(args.recordings)
    mapping, more = mapping_for(args.mapping)
    recordings, others = recordings_in(paths, mapping, named=args.mapping is not None)
    recordings, cut = while_driven(recordings)
    compared, taken = _compared(args, recordings)
    if not args.quiet:
        for note in (*notes, *more, *others, *cut, *taken):
            told.print(f"[yellow]note[/] {escape(note)}", soft_wrap=True)
    beside = bool(args.against or args.parameters)
    found = compared.replays
    if args.json and compared.predictions:
        console.print_json(json.dumps([plain_drive(p) for p in compared.predictions]))
    elif args.json:
        console.print_json(json.dumps([_plain(r, beside) for r in found]))
    elif compared.predictions:
        console.print(drive_table(compared.predictions))
    else:
        for kind in dict.fromkeys((r.channel, r.unit) for r in found):
            console.print(_table([r for r in found if (r.channel, r.unit) == kind], beside))
    if args.out:
        folder = free_folder(Path(args.out), lambda at: not at.exists() or not any(at.iterdir()))
        (write_drives if compared.predictions else _write)(compared, folder)
        (told if args.json else console).print(f"  pictures in {escape(str(folder))}", soft_wrap=True, highlight=False)
    return 0


def _compared(args: argparse.Namespace, recordings: list[Recording]) -> tuple[Comparison, tuple[str, ...]]:
    """The model on all recordings, another one beside it if asked, and notes on what was done to both."""
    from trueup.loop.prepare import prepare

    ready = prepare(args.model, (), recordings, parameters=args.parameters, propose=False, step=args.step,
                    refuse=args.refuse)  # fmt: skip
    channels = [c.strip() for c in args.channels.split(",")] if args.channels else None
    compared = ready.compare(args.against, channels=channels, step=args.step)
    return compared, (*ready.notes, *refusable(ready.diagnoses), *compared.notes)


def _write(compared: Comparison, folder: Path) -> None:
    """A picture of each recording, and of each further channel."""
    first = compared.replays[0]
    for replay in compared.replays:
        same = replay.channel == first.channel
        kind = "" if same and replay.unit == first.unit else f"-{replay.unit if same else replay.channel}"
        write_aside(replay_picture(replay), folder / f"{replay.recording}{kind.replace('/', ' per ')}.svg")


def _table(found: list[Replay], compared: bool) -> Table:
    """A row a recording, one a joint over all recordings, and one for everything."""
    scale = scale_for(found[0].unit, [pooled_rmse([r], after=True) for r in found])
    title = f"{found[0].channel}: root mean square of simulated minus measured, in {scale.unit}"
    noise = float(np.nanmedian(np.concatenate([r.noise for r in found])))
    table = Table(box=SIMPLE, title=escape(title), title_justify="left", caption_justify="left")
    table.caption = f"measurement noise about {scale.text(noise, 2)} {scale.unit}"
    table.add_column("")
    for name in ("against", "error", "ratio") if compared else ("error",):
        table.add_column(name, justify="right")
    table.add_column("most in")

    def row(name: str, parts: list[Replay], most: str, *, end_section: bool = False) -> None:
        before, after = pooled_rmse(parts, after=False), pooled_rmse(parts, after=True)
        colour = "red" if compared and after > before else "green" if compared else ""
        error = f"[{colour}]{scale.text(after)}[/]" if colour else scale.text(after)
        cells = (scale.text(before), error, ratio_text(after, before)) if compared else (error,)
        table.add_row(escape(name), *cells, escape(most), end_section=end_section)

    for k, replay in enumerate(found, 1):
        worst = int(np.nanargmax(replay.rmse_after()))
        most = f"{replay.labels[worst]} {scale.text(float(replay.rmse_after()[worst]))}"
        row(replay.recording, [replay], most, end_section=k == len(found))
    labels = tuple(dict.fromkeys(label for r in found for label in r.labels))
    for k, label in enumerate(labels, 1):
        parts = [_column(r, label) for r in found if label in r.labels]
        worst_of = max(parts, key=lambda r: float(np.nan_to_num(r.rmse_after()[0])))
        row(label, parts, worst_of.recording if len(parts) > 1 else "", end_section=k == len(labels))
    row("all", found, "")
    return table


def _column(replay: Replay, label: str) -> Replay:
    """One joint of a replay."""
    j = [replay.labels.index(label)]
    cut = {"measured": replay.measured[:, j], "before": replay.before[:, j], "after": replay.after[:, j]}
    return replace(replay, labels=(label,), command=None, **cut)


def _plain(replay: Replay, compared: bool) -> dict[str, Any]:
    plain: dict[str, Any] = {
        "recording": replay.recording, "channel": replay.channel, "unit": replay.unit, "labels": list(replay.labels),
        "rmse": [finite(v) for v in replay.rmse_after()], "pooled": finite(pooled_rmse([replay], after=True)),
    }  # fmt: skip
    if compared:
        plain["rmse_against"] = [finite(v) for v in replay.rmse_before()]
        plain["pooled_against"] = finite(pooled_rmse([replay], after=False))
    return plain
