# SPDX-License-Identifier: Apache-2.0
"""`trueup replay`: how well a model replays recordings as it is, or two models side by side. Nothing is fitted."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from trueup.calibration import Ahead, Replay, by_label, pooled_rmse
from trueup.campaign.output import free_folder
from trueup.commands.between import add_between, what_is_between, with_commands_between
from trueup.commands.console import notes, table_of, tell
from trueup.commands.replay_drives import drive_table, plain_drive, write_drives
from trueup.commands.sources import add_engine, add_refuse, add_shared, given, made_by, refusable, step_of
from trueup.formats.aside import write_aside
from trueup.formats.plain import finite
from trueup.formats.replayed import KINDS, write_replays
from trueup.recording import Recording
from trueup.report import replay_picture
from trueup.report.numbers import ratio_text, scale_for
from trueup.report.replay_page import ahead_of, errors_of, scale_of, write_replay_report
from trueup.trial import STEP

if TYPE_CHECKING:
    from trueup.loop.prepare import Comparison

ABOUT = """\
Replays recordings in a model (MJCF or URDF, or a car's TOML file) as it is and shows how far it is from them, joint by
joint. Nothing is fitted: it judges a model on new recordings, tells whether the robot has changed since it was calibrated,
and puts two models side by side. A car is predicted 1 s and 3 s ahead, again and again.

  trueup replay robot.xml logs/*.csv
  trueup replay fit/robot.xml new/*.csv --against robot.xml --out compared
  trueup replay robot.xml new/*.csv --parameters fit/parameters.toml    with what an MJCF cannot say (sensor errors, ...)
  trueup replay robot.xml new/*.csv --grounding ground/grounding.npz    grounded (`trueup ground`), beside as it is
  trueup replay fit/car.toml new_drives/*.csv --out predicted

Root mean square, mean size and the error at the end are of one long replay; "ahead" are of predictions that begin again and
again where the robot was measured to be. A recording on which the simulation breaks off, or is refused by a grounding, is
named, the others are shown, and the exit code is 1. In DIR: report.html, pictures, and what was measured and simulated as
CSV, NPZ or Parquet (--trajectories).
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What this command takes."""
    parser.add_argument("model", metavar="MODEL", help="MJCF or URDF of the robot, or a car's TOML file")
    add_shared(parser, "recordings", "mapping", "json", "quiet")
    parser.add_argument(
        "--parameters", metavar="FILE", help="values to apply (TOML), as `trueup calibrate` writes them"
    )
    parser.add_argument("--against", metavar="MODEL", help="another model to compare with (default with --parameters: "
                        "MODEL without them)")  # fmt: skip
    parser.add_argument("--grounding", metavar="FILE", help="pass commands through what `trueup ground` has learned")
    parser.add_argument("--channels", metavar="LIST", help="measured channels to compare, with commas (default: "
                        "position, or whatever there is)")  # fmt: skip
    parser.add_argument("--step", type=step_of, metavar="S", help="integration step in s (default: the model's own)")
    add_engine(parser)
    add_refuse(parser)
    add_between(parser)
    parser.add_argument("--out", metavar="DIR", help="folder for report.html, a picture of each recording and trajectories; "
                        "the next run takes DIR-2")  # fmt: skip
    parser.add_argument("--trajectories", choices=KINDS, default="csv", metavar="KIND",
                        help="how measured and simulated trajectories are written into DIR: csv, npz or parquet "
                             "(default: %(default)s)")  # fmt: skip


def run(args: argparse.Namespace, console: Console, told: Console) -> int:
    """Replays, shows a table, writes pictures if asked. Raises TrueupError. Returns the exit code."""
    recordings, _, found = given(args, told)
    between = what_is_between(recordings, args.commands, args.step or STEP)
    recordings = with_commands_between(recordings, args.commands, args.step or STEP)
    compared, taken = _compared(args, recordings)
    missing = tuple(f"not replayed: {why}" for _, why in compared.failed)
    said = (*found, *between, *taken, *missing)
    notes(told, said[: len(said) - len(missing)], quiet=args.quiet)
    beside = bool(args.against or args.parameters or args.grounding)
    replays = compared.replays
    if args.json and compared.predictions:
        console.print_json(data=[plain_drive(p) for p in compared.predictions])
    elif args.json:
        broken = [{"recording": recording.name, "failed": why} for recording, why in compared.failed]
        console.print_json(data=[*(_plain(r, beside, compared.ahead) for r in replays), *broken])
    elif compared.predictions:
        console.print(drive_table(compared.predictions))
    else:
        for kind in dict.fromkeys((r.channel, r.unit) for r in replays):
            console.print(_table([r for r in replays if (r.channel, r.unit) == kind], beside))
            console.print(_further([r for r in replays if (r.channel, r.unit) == kind], compared.ahead))
    if args.out:
        folder = free_folder(Path(args.out))
        if compared.predictions:
            write_drives(compared, folder)
        else:
            _write(args, compared, folder, said)
        what = "pictures" if compared.predictions else "report.html, pictures and trajectories"
        tell(told if args.json else console, f"  {what} in {escape(str(folder))}")
    for sentence in missing:
        tell(told, f"[bold red]error[/] {escape(sentence)}")
    return 1 if missing else 0


def _compared(args: argparse.Namespace, recordings: list[Recording]) -> tuple[Comparison, tuple[str, ...]]:
    """The model on all recordings, another one beside it if asked, and notes on what was done to both."""
    from trueup.loop.prepare import prepare

    ready = prepare(args.model, (), recordings, parameters=args.parameters, propose=False, step=args.step, engine=args.engine,
                    refuse=args.refuse)  # fmt: skip
    if args.grounding:
        from trueup.grounding.grounded import GroundedSimulator
        from trueup.grounding.grounding import Grounding

        ready = replace(ready, simulator=GroundedSimulator(ready.simulator, Grounding.load(args.grounding)))
    channels = [c.strip() for c in args.channels.split(",")] if args.channels else None
    compared = ready.compare(args.against, channels=channels, step=args.step)
    return compared, (*ready.notes, *refusable(ready.diagnoses), *compared.notes)


def _further(found: Sequence[Replay], ahead: Sequence[Ahead]) -> Table:
    """Other errors of the model, over all recordings, by joint: mean size, at the end, ahead."""
    scale = scale_of(found)
    own = [a for a in ahead if a.channel == found[0].channel]
    horizons = own[0].horizons if own else ()
    ahead_in = (*(["next sample"] if horizons else []), *(f"{h:g} s ahead" for h in horizons[1:]))
    title = f"{found[0].channel}, other errors in {scale.unit}"
    table = table_of("", "mean size", "at the end", *ahead_in, title=escape(title))
    joints = by_label(found)
    for k, (name, parts) in enumerate((*joints.items(), ("all", found)), 1):
        seen = {(r.recording, label) for r in parts for label in r.labels}
        values = (*errors_of(parts)[1:], *ahead_of(own, seen, len(horizons)))
        table.add_row(escape(name), *(scale.text(v) for v in values), end_section=k == len(joints))
    if horizons:
        table.caption = "ahead: predictions that begin again and again where the robot was measured to be"
    return table


def _write(args: argparse.Namespace, compared: Comparison, folder: Path, said: Sequence[str]) -> None:
    """A report, a picture of each recording and of each further channel, trajectories."""
    without = " and ".join(n for n in ("parameters", "grounding") if getattr(args, n))
    beside = bool(args.against or without)
    against = (
        Path(args.against).name if args.against else f"{Path(args.model).name} without {without}" if beside else ""
    )
    shown = (
        compared.replays
        if beside
        else tuple(replace(r, before=np.full_like(r.before, np.nan)) for r in compared.replays)
    )
    compared = replace(compared, replays=shown)
    write_replay_report(shown, folder / "report.html", model=Path(args.model).name, ahead=compared.ahead, against=against,
                        notes=said, context=made_by(args))  # fmt: skip
    write_replays(shown, folder, args.trajectories, compared=beside)
    first, names = compared.replays[0], {"before": against, "after": Path(args.model).name}
    for replay in compared.replays:
        same = replay.channel == first.channel
        kind = "" if same and replay.unit == first.unit else f"-{replay.unit if same else replay.channel}"
        write_aside(replay_picture(replay, names=names), folder / f"{replay.recording}{kind.replace('/', ' per ')}.svg")


def _table(found: list[Replay], compared: bool) -> Table:
    """A row a recording, one a joint over all recordings, and one for everything."""
    scale = scale_for(found[0].unit, [pooled_rmse([r], after=True) for r in found])
    title = f"{found[0].channel}: root mean square of simulated minus measured, in {scale.unit}"
    noise = float(np.nanmedian(np.concatenate([r.noise for r in found])))
    table = table_of(
        "", *(("against", "error", "ratio") if compared else ("error",)), "most in", words=("", "most in"),
        title=escape(title), caption=f"measurement noise about {scale.text(noise, 2)} {scale.unit}",
    )  # fmt: skip

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
    joints = by_label(found)
    for k, (label, parts) in enumerate(joints.items(), 1):
        worst_of = max(parts, key=lambda r: float(np.nan_to_num(r.rmse_after()[0])))
        row(label, parts, worst_of.recording if len(parts) > 1 else "", end_section=k == len(joints))
    row("all", found, "")
    return table


def _plain(replay: Replay, compared: bool, ahead: Sequence[Ahead]) -> dict[str, Any]:
    plain: dict[str, Any] = {
        "recording": replay.recording, "channel": replay.channel, "unit": replay.unit, "labels": list(replay.labels),
        "rmse": [finite(v) for v in replay.rmse_after()], "pooled": finite(pooled_rmse([replay], after=True)),
    }  # fmt: skip
    plain["mae"], plain["end"] = ([finite(v) for v in of()] for of in (replay.mae_after, replay.end_after))
    own = [a for a in ahead if (a.recording, a.channel, a.unit) == (replay.recording, replay.channel, replay.unit)]
    plain["ahead"] = [
        {"horizon": h, "rmse": finite(rmse.tolist())} for a in own for h, rmse in zip(a.horizons, a.rmse(), strict=True)
    ]
    if compared:
        plain["rmse_against"] = [finite(v) for v in replay.rmse_before()]
        plain["pooled_against"] = finite(pooled_rmse([replay], after=False))
    return plain
