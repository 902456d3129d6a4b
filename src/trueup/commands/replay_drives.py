# SPDX-License-Identifier: Apache-2.0
"""`trueup replay` for cars: how far their predictions go astray on recorded drives, as a table, JSON and pictures."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from trueup.campaign.cars import HORIZONS, Predicted, predictions
from trueup.campaign.output import free_folder
from trueup.errors import ModelError
from trueup.recording import Recording
from trueup.report.drive_picture import drive_picture
from trueup.report.numbers import ratio_text, scale_for
from trueup.report.writing import write_aside

Array = NDArray[np.float64]


def run_drives(
    args: argparse.Namespace, recordings: Sequence[Recording], notes: Sequence[str], console: Console, told: Console
) -> int:
    """Predicts, shows a table, writes pictures if asked. Raises TrueupError. Returns the exit code."""
    if args.parameters or args.channels:
        raise ModelError(
            f"{args.model}: a car has no parameters file and is judged by position and heading; leave out --parameters and "
            "--channels (its own values are in [vehicle.values])"
        )
    found, more = predictions(Path(args.model), recordings, Path(args.against) if args.against else None)
    if not args.quiet:
        for note in (*notes, *more):
            told.print(f"[yellow]note[/] {escape(note)}", soft_wrap=True)
    if args.json:
        console.print_json(json.dumps([_plain(p) for p in found]))
    else:
        console.print(_table(found))
    if args.out:
        folder = free_folder(Path(args.out), lambda at: not at.exists() or not any(at.iterdir()))
        for one in found:
            position, heading = one.replays
            write_aside(
                drive_picture(position, heading, compared=one.against is not None), folder / f"{one.recording}.svg"
            )
        (told if args.json else console).print(f"  pictures in {escape(str(folder))}", soft_wrap=True, highlight=False)
    return 0


def _table(found: Sequence[Predicted]) -> Table:
    """A row a drive and one over all predictions: mean error at each horizon."""
    scale = scale_for("m", [float(p.errors.mean()) for p in found])
    title = f"predicted position, mean error in {scale.unit}"
    table = Table(box=SIMPLE, title=title, title_justify="left", caption_justify="left")
    compared = found[0].against is not None
    table.add_column("")
    for horizon in HORIZONS:
        for name in ("against", f"in {horizon:g} s", "ratio") if compared else (f"in {horizon:g} s",):
            table.add_column(name, justify="right")
    table.add_column("it went", justify="right")
    table.add_column("of", justify="right")
    table.caption = (
        f"each prediction goes on from what was measured until it began, under the recorded commands alone; 'it went': in "
        f"{max(HORIZONS):g} s, in the mean; 'of': how many predictions"
    )

    def row(name: str, parts: Sequence[Predicted], *, end_section: bool = False) -> None:
        errors = np.concatenate([p.errors for p in parts])
        others = [p.against for p in parts if p.against is not None]
        cells: list[str] = []
        for k in range(len(HORIZONS)):
            mine = float(errors[:, k].mean())
            if not others:
                cells.append(scale.text(mine))
                continue
            other = float(np.concatenate(others)[:, k].mean())
            colour = "red" if mine > other else "green"
            cells += [scale.text(other), f"[{colour}]{scale.text(mine)}[/]", ratio_text(mine, other)]
        way = float(np.average([p.moved for p in parts], weights=[len(p.errors) for p in parts]))
        table.add_row(escape(name), *cells, f"{way:.3g} m", f"{len(errors)}", end_section=end_section)

    for k, one in enumerate(found, 1):
        row(one.recording, [one], end_section=k == len(found))
    if len(found) > 1:
        row("all", found)
    return table


def _plain(one: Predicted) -> dict[str, Any]:
    plain: dict[str, Any] = {
        "recording": one.recording,
        "unit": "m",
        "predictions": len(one.errors),
        "moved": one.moved,
    }
    for name, errors in (("ahead", one.errors), ("ahead_against", one.against)):
        if errors is not None:
            plain[name] = [
                {
                    "horizon": h,
                    "mean": float(e.mean()),
                    "median": float(np.median(e)),
                    "rms": float(np.sqrt(np.mean(e**2))),
                }
                for h, e in zip(HORIZONS, errors.T, strict=True)
            ]
    return plain
