# SPDX-License-Identifier: Apache-2.0
"""`trueup replay` for cars: how far their predictions go astray on recorded drives, as a table, JSON and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.markup import escape
from rich.table import Table

from trueup.arrays import Array
from trueup.calibration import Prediction
from trueup.commands.console import table_of
from trueup.formats.aside import write_aside
from trueup.report.drive_picture import drive_picture
from trueup.report.numbers import ratio_text, scale_for
from trueup.samples import rms

if TYPE_CHECKING:
    from trueup.loop.prepare import Comparison


def write_drives(compared: Comparison, folder: Path) -> None:
    """A picture of each drive that is predicted."""
    for one in compared.predictions:
        position, heading = (
            next(r for r in compared.replays if (r.recording, r.channel) == (one.recording, channel))
            for channel in ("position", "heading")
        )
        write_aside(drive_picture(position, heading, compared=one.against is not None), folder / f"{one.recording}.svg")


def drive_table(found: Sequence[Prediction]) -> Table:
    """A row a drive and one over all predictions: mean error at each horizon."""
    horizons = found[0].horizons
    scale = scale_for("m", [float(np.nanmean(p.errors)) for p in found])
    before, ratio = (("against",), ("ratio",)) if found[0].against is not None else ((), ())
    errors = (name for h in horizons for name in (*before, f"in {h:g} s", *ratio))
    table = table_of(
        "", *errors, "it went", "of", title=f"predicted position, mean error in {scale.unit}",
        caption="each prediction goes on from what was measured until it began, under the recorded commands alone; 'it "
        f"went': in {max(horizons):g} s, in the mean; 'of': how many predictions; a drive of a few seconds is predicted "
        "once, from its first state",
    )  # fmt: skip

    def row(name: str, parts: Sequence[Prediction], *, end_section: bool = False) -> None:
        errors = np.concatenate([p.errors for p in parts])
        others = [p.against for p in parts if p.against is not None]
        cells: list[str] = []
        for k in range(len(horizons)):
            mine = _mean(errors[:, k])
            if mine is None or not others:  # None: it does not last so long
                cells += ["-"] * (3 if others else 1) if mine is None else [scale.text(mine)]
                continue
            other = _mean(np.concatenate(others)[:, k]) or 0.0
            colour = "red" if mine > other else "green"
            cells += [scale.text(other), f"[{colour}]{scale.text(mine)}[/]", ratio_text(mine, other)]
        way = float(np.average([p.moved for p in parts], weights=[len(p.errors) for p in parts]))
        table.add_row(escape(name), *cells, f"{way:.3g} m", f"{len(errors)}", end_section=end_section)

    for k, one in enumerate(found, 1):
        row(one.recording, [one], end_section=k == len(found))
    if len(found) > 1:
        row("all", found)
    return table


def _mean(errors: Array) -> float | None:
    """Of those (S,) that are known; None where none is."""
    known = errors[np.isfinite(errors)]
    return float(known.mean()) if len(known) else None


def plain_drive(one: Prediction) -> dict[str, Any]:
    """The errors as plain numbers, for scripts."""
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
                    "rms": float(rms(e)),
                }
                for h, e in ((h, e[np.isfinite(e)]) for h, e in zip(one.horizons, errors.T, strict=True))
                if len(e)
            ]
    return plain
