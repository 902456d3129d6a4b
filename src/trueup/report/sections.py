# SPDX-License-Identifier: Apache-2.0
"""The report's sections, in the order of the questions that its reader asks."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Calibration, CrossValidation, Estimate
from trueup.inspection.relations import CORRELATED
from trueup.report.figures import correlations
from trueup.report.headline import headline
from trueup.report.joints import joints
from trueup.report.markup import Markup, breakable, join, tag
from trueup.report.numbers import Scale, duration_text, fixed, ratio_text, scale_for
from trueup.report.parameter_table import VERDICTS, parameter_table, verdict_chip
from trueup.report.parts import (
    LISTED,
    Section,
    callout,
    caption,
    cells,
    context_table,
    drawn_later,
    empty,
    facts,
    head,
    sentences,
    table,
)
from trueup.report.summary import Score


def sections(calibration: Calibration, context: Mapping[str, str]) -> tuple[Section, ...]:
    """All sections of the report. `context` is shown as it is: versions, command line, whatever the caller knows."""
    return (
        Section("better", "Better?", "Is it better, and on motions it never saw?", headline(calibration)),
        Section("joints", "Which joint?", "Which joint, when, and why not yet?", joints(calibration)),
        Section("numbers", "The numbers", "What are the numbers, and how sure are they?", parameter_table(calibration)),
        Section("limits", "What is missing", "What could these recordings not tell?", _limits(calibration)),
        Section("search", "How it was found", "How was it found?", _search(calibration, context)),
    )


def _limits(calibration: Calibration) -> Markup:
    parts: list[Markup] = []
    if calibration.unidentified:
        parts.append(sentences(calibration.unidentified))
    elif not any(e.verdict in _DOUBTFUL for e in calibration.estimates):
        text = "No direction was named that these recordings could not see, and no fitted parameter is in doubt."
        parts.append(tag("p", text))
    if calibration.lacking:
        parts.append(callout("warn", "", calibration.lacking))
    parts += _doubtful(calibration.estimates)
    if calibration.warnings:
        parts.append(tag("h3", "Warnings"))
        parts += [callout("warn", "", w) for w in calibration.warnings]
    parts.append(tag("h3", "Which estimates hang together"))
    parts += _correlated(calibration)
    return join(parts)


_DOUBTFUL = ("at bound", "not identified", "no effect", "weak")


def _doubtful(estimates: tuple[Estimate, ...]) -> list[Markup]:
    rows = []
    for verdict in _DOUBTFUL:
        names = [e.name for e in estimates if e.verdict == verdict]
        if names:
            written = [tag("span", breakable(n), class_="parameter") for n in names]
            listed = join(written[:1], [join(", ", name) for name in written[1:]])
            rows.append((verdict_chip(verdict), join(listed, tag("small", VERDICTS[verdict]))))
    return [tag("h3", "Parameters in doubt"), facts(rows, "doubtful")] if rows else []


def _correlated(calibration: Calibration) -> list[Markup]:
    matrix = correlations(calibration)
    if matrix is None:
        return [empty("No covariance was estimated, so there are no correlations to show.")]
    if matrix.shape[0] < 2:
        return [empty("Only one parameter was fitted.")]
    names = [e.name for e in calibration.estimates if e.fitted]
    pairs = _strong_pairs(matrix, names)
    parts = []
    if pairs:
        text = f"These pairs correlate by more than {CORRELATED}: the recordings tell a combination, not each alone."
        rows = [tag("tr", cells(a, b, kind="parameter"), cells(fixed(r, 3))) for a, b, r in pairs[:LISTED]]
        titles = head("Parameter", "with", "Correlation", numbers=(2,))
        parts += [tag("p", text), table(titles, rows, "pairs")]
        if len(pairs) > LISTED:
            parts.append(caption(f"and {len(pairs) - LISTED} more pairs"))
    else:
        parts.append(tag("p", f"No two estimates correlate by more than {CORRELATED}."))
    text = "Correlation of the fitted parameters' estimates. White: independent."
    return [*parts, drawn_later("correlation"), caption(text)]


def _strong_pairs(matrix: Array, names: list[str]) -> list[tuple[str, str, float]]:
    upper = np.triu(np.nan_to_num(matrix), k=1)
    rows, columns = np.nonzero(np.abs(upper) > CORRELATED)
    found = [(names[i], names[j], float(upper[i, j])) for i, j in zip(rows, columns, strict=True)]
    return sorted(found, key=lambda pair: -abs(pair[2]))


def _search(calibration: Calibration, context: Mapping[str, str]) -> Markup:
    parts = [facts(_effort(calibration))]
    if calibration.trace:
        text = "Replay error of the fitted recordings, pooled over all joints, as the search went on."
        parts += [tag("h3", "Search trace"), drawn_later("trace"), caption(text)]
    parts.append(tag("h3", "Leave one recording out"))
    parts += _crossed(calibration.cross_validation)
    if calibration.notes:
        parts += [tag("h3", "Choices made"), sentences(calibration.notes)]
    if context:
        parts += [tag("h3", "Provenance"), context_table({k: tag("code", v) for k, v in context.items()})]
    return join(parts)


def _effort(calibration: Calibration) -> list[tuple[str, str]]:
    return [
        ("time", duration_text(calibration.seconds)),
        ("processor time", duration_text(calibration.cpu_seconds)),
        ("candidates simulated", f"{calibration.evaluations:,}".replace(",", "\u202f")),
        ("fitted recordings", str(len({r.recording for r in calibration.training()}))),
        ("held-out recordings", str(len({r.recording for r in calibration.held_out()}))),
    ]


def _crossed(crossed: tuple[CrossValidation, ...]) -> list[Markup]:
    if not crossed:
        return [empty("Not done in this calibration.")]
    scales = {u: scale_for(u, [c.rmse_after for c in crossed if c.unit == u]) for u in {c.unit for c in crossed}}
    rows = [_crossed_row(c, scales[c.unit]) for c in crossed]
    worse = sum(_score(c).worse for c in crossed)
    text = "Each recording was replayed with a fit that never saw it."
    if any(math.isfinite(c.rmse_before) for c in crossed):
        came = f"{worse} of {len(crossed)} came out worse" if worse else "Every one came out no worse"
        text += f" {came} than before."
    titles = head("Recording left out", "Before", "Fit without it", "Ratio", numbers=range(1, 4))
    return [tag("p", text), table(titles, rows, "crossed")]


def _crossed_row(c: CrossValidation, scale: Scale) -> Markup:
    return tag(
        "tr",
        tag("th", c.recording, scope="row", class_="name", title=c.recording),
        cells(f"{scale.text(c.rmse_before)} {scale.unit}", kind="number before"),
        cells(f"{scale.text(c.rmse_after)} {scale.unit}", kind="number after"),
        cells(ratio_text(c.rmse_after, c.rmse_before), kind="number worse" if _score(c).worse else "number"),
    )


def _score(c: CrossValidation) -> Score:
    return Score(c.rmse_before, c.rmse_after, math.nan)
