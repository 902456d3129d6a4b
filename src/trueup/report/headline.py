# SPDX-License-Identifier: Apache-2.0
"""First section: is it better, and on motions that the fit never saw?"""

from __future__ import annotations

import math
from collections.abc import Sequence

from trueup.calibration import Calibration, Replay
from trueup.errors import counted
from trueup.report.dumbbell import Axis
from trueup.report.figures import error_scale
from trueup.report.markup import Markup, join, tag
from trueup.report.numbers import Scale, ratio_text, significant, with_unit
from trueup.report.parts import LISTED, callout, caption, cells, change, facts, group_row, hero, table
from trueup.report.summary import (
    Comparison,
    Score,
    amounts,
    broken_off,
    comparisons,
    pooled_score,
    signal_size,
    worsened,
)


def headline(calibration: Calibration) -> Markup:
    """The scores in large type, a sentence, what must not be overlooked, and a chart with a row per recording."""
    groups = comparisons(calibration)
    if not groups:
        return join(callout("bad", "Nothing was replayed.", "There is no recording to compare the model with."))
    parts: list[str] = []
    for position, group in enumerate(groups):
        if len(groups) > 1:
            parts.append(tag("h3", group.title))
        parts += _comparison(group, calibration, first=position == 0)
    return join(parts)


def verdict_sentence(group: Comparison, scale: Scale) -> str:
    """The answer in one or two sentences, plain text."""
    if not group.held_out:
        return _fitted_sentence(group, scale)
    score = pooled_score(group.held_out)
    where = (
        f"On {counted(len(group.held_out), 'recording')} that the fit never saw,{_in_windows(group)} the replay error"
    )
    before, after = _amounts(score, scale)
    if not score.compared and math.isfinite(score.after):
        return f"{where} is {after}. The model as it was given has nothing to compare with: its drives were unknown."
    if math.isnan(score.after):
        return f"{where} cannot be told: the calibrated model could not be simulated."
    if score.worse:
        return (
            f"{where} rose from {before} to {after}. The calibrated model is worse than the one it started from: "
            "do not use it for other motions."
        )
    if not score.better:
        return f"{where} did not change ({before} before, {after} after)."
    noise = with_unit(scale.text(score.noise, 2), scale.unit)
    floor = f" Measurement noise alone would leave {noise}." if math.isfinite(score.noise) else ""
    return f"{where} fell from {before} to {after}, {ratio_text(score.after, score.before)} as large.{floor}"


def _fitted_sentence(group: Comparison, scale: Scale) -> str:
    score = pooled_score(group.training)
    before, after = _amounts(score, scale)
    where = f"On the recordings that were fitted,{_in_windows(group)} the replay error"
    if not score.compared:
        return f"{where} is {after}; there is no model to compare with."
    moved = "fell" if score.better else "rose" if score.worse else "went"
    return f"{where} {moved} from {before} to {after}."


def _in_windows(group: Comparison) -> str:
    """How replays began anew, to be read within a sentence; '' where they are whole."""
    longest = max(replay.window for replay in group.replays)
    return f" replayed {longest:.2g} s at a time from where the robot was," if math.isfinite(longest) else ""


def _comparison(group: Comparison, calibration: Calibration, *, first: bool) -> list[str]:
    scale = error_scale(group)
    judged = group.held_out or group.training
    parts: list[str] = []
    if not group.held_out and first:
        parts.append(_nothing_held_out(calibration, scale))
    parts.append(_hero(group, pooled_score(judged), scale))
    parts += _broken(group.replays, after=True)
    parts += _broken(group.replays, after=False)
    parts += _ran_away(group.replays)
    parts += _worse(judged, scale, held_out=bool(group.held_out))
    parts.append(_chart(group, scale))
    return parts


def _nothing_held_out(calibration: Calibration, scale: Scale) -> Markup:
    text = (
        "Every number below is from the recordings that were fitted, and a fit always looks good on what it has seen. "
        "It says nothing about other motions. Run again with one recording held out (--hold-out NAME)."
    )
    crossed = calibration.cross_validation
    if crossed:
        mean = math.sqrt(sum(c.rmse_after**2 for c in crossed) / len(crossed))
        amount = with_unit(scale.text(mean), scale.unit)
        text += f" Until then the best guess is the leave-one-out error below: {amount}."
    return callout("bad", "Nothing was held out.", text)


def _hero(group: Comparison, score: Score, scale: Scale) -> Markup:
    kind = "worse" if score.worse else "better" if score.better else "same"
    beside = [("of the error before", ratio_text(score.after, score.before))] if score.compared else []
    if math.isfinite(score.noise):
        beside.append(("measurement noise", with_unit(scale.text(score.noise, 2), scale.unit)))
    if group.held_out and group.training:
        trained = pooled_score(group.training)
        beside.append(("on the fitted recordings", amounts(trained, scale)))
    return hero(
        "replay error, held-out recordings" if group.held_out else "replay error, fitted recordings only",
        change(scale.text(score.before) if score.compared else "", scale.text(score.after), scale.unit),
        tag("div", tag("p", verdict_sentence(group, scale), class_="verdict-sentence"), facts(beside, "hero-facts")),
        kind=f"hero {kind}" if group.held_out else f"hero {kind} unproven",
    )


def _broken(replays: Sequence[Replay], *, after: bool) -> list[Markup]:
    moments = [
        (r.recording, broken_off(r, after=after)) for r in replays if after or math.isfinite(pooled_score([r]).before)
    ]
    found = [
        tag("li", tag("b", name), f" has no simulated values from {significant(at)} s")
        for name, at in moments
        if at is not None
    ]
    if not found:
        return []
    model = "calibrated model" if after else "model before calibration"
    text = f"The {model} could not be simulated to the end. The errors count only what was simulated."
    title = "Simulation failed." if after else "Simulation failed before calibration."
    return [callout("bad" if after else "warn", title, join(text, tag("ul", found)))]


def _ran_away(replays: Sequence[Replay]) -> list[Markup]:
    """A ratio to a model that is further off than one that stands still is no success: say so."""
    names = [r.recording for r in replays if pooled_score([r]).before > signal_size(r)]
    if not names:
        return []
    text = f"Its error is larger than the motion itself in {', '.join(names)}. The ratios to it say little."
    return [callout("warn", "The model before calibration did not follow.", text)]


def _worse(replays: Sequence[Replay], scale: Scale, *, held_out: bool) -> list[Markup]:
    found = worsened(replays)
    columns = sum(len(r.labels) for r in replays)
    if not found:
        return []
    listed = [
        tag("li", tag("b", f"{replay.recording}, {label}"), f": {amounts(score, scale)}")
        for replay, label, score in found[:LISTED]
    ]
    if len(found) > LISTED:
        listed.append(tag("li", f"and {len(found) - LISTED} more: see the table of joints below"))
    where = "held-out recordings" if held_out else "fitted recordings"
    overall = [r.recording for r in replays if pooled_score([r]).worse]
    title = f"Worse than before: {len(found)} of {columns} joint and motion pairs ({where})."
    whole = f"Taken as a whole, worse on {', '.join(overall)}. " if overall else ""
    return [callout("bad" if overall else "warn", title, join(whole, tag("ul", listed)))]


def _chart(group: Comparison, scale: Scale) -> Markup:
    scores = {id(r): pooled_score([r]) for r in group.replays}
    axis = Axis.over(scores.values(), scale)
    in_unit = tag("small", scale.unit)
    titles = tag(
        "tr",
        tag("th", "Recording", scope="col"),
        tag("th", axis.ticks(scale.unit), scope="col", class_="chart"),
        [
            tag("th", t, scope="col", class_="number")
            for t in (join("Before", in_unit), join("After", in_unit), "Ratio")
        ],
    )
    rows: list[Markup] = []
    for title, replays in (("Held out: the fit never saw these", group.held_out), ("Fitted", group.training)):
        if replays:
            rows += [group_row(title, 5), *(_row(r, scores[id(r)], axis, scale) for r in replays)]
    text = (
        "Root mean square replay error of each recording, over all joints. "
        "The grey line is what measurement noise alone would leave."
    )
    return join(table(titles, rows, "dumbbells"), caption(text))


def _row(replay: Replay, score: Score, axis: Axis, scale: Scale) -> Markup:
    return tag(
        "tr",
        tag("th", replay.recording, scope="row", class_="name", title=replay.recording),
        tag("td", axis.dumbbell(score, scale), class_="chart"),
        cells(scale.text(score.before), kind="number before"),
        cells(scale.text(score.after), kind="number after"),
        cells(ratio_text(score.after, score.before), kind="number worse" if score.worse else "number"),
        class_="worse" if score.worse else None,
    )


def _amounts(score: Score, scale: Scale) -> tuple[str, str]:
    return with_unit(scale.text(score.before), scale.unit), with_unit(scale.text(score.after), scale.unit)
