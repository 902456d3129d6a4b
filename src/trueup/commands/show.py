# SPDX-License-Identifier: Apache-2.0
"""The summary of a calibration for a terminal: is it better, on motions it never saw, and what could not be told."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from trueup.calibration import Calibration, Replay
from trueup.commands.console import notes, table_of, tell
from trueup.report.numbers import duration_text, ratio_text, scale_for
from trueup.report.summary import Score, comparisons, pooled_score

_PLURALS = {"joint": "joints", "actuator": "joints", "body": "bodies", "geom": "geoms", "channel": "channels"}


def proposal_line(kinds: Sequence[tuple[str, str, int]], *, given: bool) -> str:
    """'24 parameters proposed: kp, damping, friction of 6 joints; delay' from (kind, family, count)."""
    groups: dict[str, list[str]] = {}
    for name, family, count in kinds:
        plural = _PLURALS.get(family, f"{family}s")
        groups.setdefault(f" of {count} {plural}" if count > 1 else "", []).append(name)
    listed = "; ".join(f"{', '.join(names)}{where}" for where, names in groups.items())
    total = sum(count for _, _, count in kinds)
    return f"{total} parameters {'to calibrate' if given else 'proposed'}: {listed}"


def show_outcome(calibration: Calibration, console: Console, *, quiet: bool = False) -> None:
    """Prints errors before and after (fitted, held out, each held-out motion), noise floor, and what to mind."""
    for sentence in calibration.unidentified:
        tell(console, f"[cyan]cannot tell[/] {escape(sentence)}")
    notes(console, filter(None, (*calibration.warnings, *calibration.notes, calibration.lacking)), quiet=quiet)
    every = comparisons(calibration)
    for comparison in every:
        name, some = comparison.channel, 4
        if [c.channel for c in every].count(name) > 1:  # hinges and slides
            labels = comparison.labels
            name += f" of {', '.join(labels[:some])}{' ...' * (len(labels) > some)}"
        _line(console, f"{name}, fitted", comparison.training, comparison.unit, floor=not comparison.held_out)
        _line(console, f"{name}, held out", comparison.held_out, comparison.unit, floor=True)
        if len(comparison.held_out) > 1:
            for replay in comparison.held_out:
                _line(console, f"  {replay.recording}", [replay], comparison.unit, floor=False)
    counts: dict[str, int] = {}
    for estimate in calibration.estimates:
        counts[estimate.verdict] = counts.get(estimate.verdict, 0) + 1
    told = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    spent = f"{calibration.evaluations} simulations of all recordings, {duration_text(calibration.seconds)}"
    tell(console, f"parameters: {told}   ({spent})")


def replay_table(calibration: Calibration) -> Table:
    """One row a recording: replay error before and after, those held out marked."""
    scale = scale_for(calibration.replays[0].unit, [pooled_score(calibration.replays).before])
    table = table_of("recording", "", "before", "after", "ratio", words=("recording", ""),
                     caption=f"replay error in {scale.unit}, all joints")  # fmt: skip
    for replay in sorted(calibration.replays, key=lambda r: not r.held_out):
        score = pooled_score([replay])
        kind = "held out" if replay.held_out else "fitted"
        table.add_row(escape(replay.recording), kind, scale.text(score.before), scale.text(score.after), _ratio(score))
    return table


def _line(console: Console, title: str, replays: Sequence[Replay], unit: str, *, floor: bool) -> None:
    if not replays:
        return
    score: Score = pooled_score(replays)
    scale = scale_for(unit, [score.before, score.after])
    colour = "red" if score.worse else "green" if score.better else "white"
    text = f"[{colour}]{scale.text(score.after)}[/] {scale.unit}"
    if score.compared:
        text = f"{scale.text(score.before)} -> {text}  ({_ratio(score)})"
    if floor and math.isfinite(score.noise):
        text += f"   noise floor {scale.text(score.noise, 2)} {scale.unit}"
    if score.worse:
        text += "   WORSE than shipped"
    tell(console, f"{escape(title):28} {text}")


def _ratio(score: Score) -> str:
    return ratio_text(score.after, score.before)
