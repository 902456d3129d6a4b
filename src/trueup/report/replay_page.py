# SPDX-License-Identifier: Apache-2.0
"""The report of a replay: how far a model is from recordings as it is, in pictures and in a table, as one HTML file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from trueup.calibration import Ahead, Replay, by_label, pooled_rmse
from trueup.errors import counted
from trueup.formats.aside import write_aside
from trueup.report.markup import Markup, join, tag
from trueup.report.numbers import Scale, duration_text, ratio_text, scale_for
from trueup.report.parts import (
    Section,
    caption,
    cells,
    change,
    context_table,
    facts,
    group_row,
    head,
    hero,
    page,
    row,
    table,
)
from trueup.report.picture import replay_picture
from trueup.report.summary import known_rms

_STYLE = """
figure.replay { overflow-x: auto; margin: 0 0 20px; }
figure.replay svg { width: 100%; min-width: 560px; height: auto; }
"""


def write_replay_report(
    replays: Sequence[Replay], path: Path, *, model: str, ahead: Sequence[Ahead] = (), against: str = "",
    notes: Sequence[str] = (), context: Mapping[str, str] | None = None,
) -> Path:  # fmt: skip
    """Writes the report of `replays` (`before` is that of `against`, '' for none) to an HTML file. Raises OutputError."""
    shown = 6  # recordings with a picture; the others are files beside
    kinds = dict.fromkeys((r.channel, r.unit) for r in replays)
    groups = [[r for r in replays if (r.channel, r.unit) == kind] for kind in kinds]
    names = {"before": against, "after": model}
    worst = sorted(groups[0], key=lambda r: -pooled_rmse([r], after=True))[:shown]
    drawn = tag("div", [tag("figure", Markup(replay_picture(r, names=names)), class_="replay") for r in worst])
    parts = [
        Section("far", "How far?", "How far is the model from the recordings?", _headline(groups, against)),
        Section("which", "Which?", "Which recording, which joint?",
                join(_table(g, [a for a in ahead if a.channel == g[0].channel], against) for g in groups)),
        Section("look", "Look", "What does it look like? The worst first", drawn),
        Section("made", "Made of", "What was replayed, and how?", _context(notes, context or {})),
    ]  # fmt: skip
    subtitle = [counted(len({r.recording for r in replays}), "recording"), f"beside {against}" if against else ""]
    write_aside(page("campaign.html", f"Replay by {model}", subtitle, parts, style=_STYLE), path)
    return path


def _headline(groups: Sequence[Sequence[Replay]], against: str) -> Markup:
    """A number in large type for each channel, with the noise, the size of the motion and how long was replayed."""
    parts = []
    for group in groups:
        after, before = (pooled_rmse(group, after=a) for a in (True, False))
        scale = scale_for(group[0].unit, [after])
        noise = known_rms([r.noise for r in group])
        moved = math.sqrt(float(np.nanmean([np.nanvar(r.measured, axis=0).mean() for r in group])))
        beside = [("measurement noise", f"{scale.text(noise, 2)} {scale.unit}"),
                  ("of the motion itself", f"{100 * after / moved:.2g} %" if moved else "–"),
                  ("replayed", duration_text(sum(float(r.time[-1] - r.time[0]) for r in group)))]  # fmt: skip
        if against:
            beside.insert(0, (f"of the error of {against}", ratio_text(after, before)))
        shown = change(scale.text(before) if against else "", scale.text(after), scale.unit)
        words = "better" if against and after < before else "worse" if against and after > before else "same"
        parts.append(
            hero(
                f"{group[0].channel}, root mean square error", shown, facts(beside, "hero-facts"), kind=f"hero {words}"
            )
        )
    return join(parts)


def _table(group: Sequence[Replay], ahead: Sequence[Ahead], against: str) -> Markup:
    """A row a recording and one a joint: RMSE, MAE, error at the end, errors ahead."""
    scale = scale_for(group[0].unit, [pooled_rmse(group, after=True)])
    horizons = ahead[0].horizons if ahead else ()
    beyond = [f"{h:g} s ahead" for h in horizons[1:]]
    titles = ["", *(["Against"] if against else []), "RMSE", "Mean size", "At the end",
              *(["Next sample"] if horizons else []), *beyond]  # fmt: skip

    def line(name: str, parts: Sequence[Replay]) -> Markup:
        values = [*([pooled_rmse(parts, after=False)] if against else []), *errors_of(parts)]
        seen = {(r.recording, label) for r in parts for label in r.labels}
        return row(name, cells(*(scale.text(v) for v in (*values, *ahead_of(ahead, seen, len(horizons))))))

    rows = [group_row("Recordings, all joints", len(titles))]
    rows += [line(r.recording, [r]) for r in group]
    rows += [group_row("Joints, all recordings", len(titles))]
    rows += [line(label, parts) for label, parts in by_label(group).items()]
    said = f"{group[0].channel} in {scale.unit}." if scale.unit else f"{group[0].channel}."
    if horizons:
        said += (" Ahead: predictions that begin again and again where the robot was measured to be, by samples until then "
                 f"alone; the next sample is {1e3 * horizons[0]:.3g} ms later.")  # fmt: skip
    return join(table(head(*titles, numbers=range(1, len(titles))), rows), caption(said))


def errors_of(replays: Sequence[Replay]) -> tuple[float, float, float]:
    """Root mean square, mean size, and root mean square at the end, of replays in one unit."""
    error = np.concatenate([np.abs(r.after - r.measured).ravel() for r in replays])
    error = error[np.isfinite(error)]
    mean = float(error.mean()) if error.size else math.nan
    return pooled_rmse(replays, after=True), mean, known_rms([r.end_after() for r in replays])


def ahead_of(ahead: Sequence[Ahead], seen: set[tuple[str, str]], count: int) -> list[float]:
    """Root mean square of what was predicted, by horizon, of some recordings' labels."""
    found = []
    for h in range(count):
        parts = [a.errors[:, h, k] for a in ahead for k, label in enumerate(a.labels)
                 if (a.recording, label) in seen and h < len(a.horizons)]  # fmt: skip
        found.append(known_rms(parts))
    return found


def _context(notes: Sequence[str], context: Mapping[str, str]) -> Markup:
    said = tag("ul", [tag("li", note) for note in notes], class_="sentences") if notes else None
    return join([x for x in (said, context_table(context)) if x])


def scale_of(replays: Sequence[Replay]) -> Scale:
    """The scale to show the errors of replays in."""
    return scale_for(replays[0].unit, [pooled_rmse([r], after=True) for r in replays])
