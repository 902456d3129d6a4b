# SPDX-License-Identifier: Apache-2.0
"""The figures of an identification's report: torque with bounds, errors by axis, residuals by speed, where it holds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array
from trueup.evidence import half_interval
from trueup.identification.estimation.result import Identification, Prediction, rmse
from trueup.noise import FEWEST
from trueup.report.drawing import SAMPLES
from trueup.report.encoding import kept_samples
from trueup.report.markup import Markup, join, tag
from trueup.report.numbers import significant
from trueup.report.plots import AFTER, FAINT, INK, SOFT, Plot, span
from trueup.samples import rms

_SPEED_BINS, _CELLS = 15, 14


def torque_figures(result: Identification, prediction: Prediction) -> Markup:
    """Measured and predicted torque of each joint; bounds are the prediction +- the RMSE (evolved trajectories, eq. 10)."""
    bound = rmse(result.judged())
    figures = []
    for j, joint in enumerate(result.joints):
        measured, model = prediction.measured[:, j], prediction.fitted[:, j]
        kept = kept_samples([measured, model], SAMPLES)
        t, low, high = prediction.time[kept], model[kept] - bound[j], model[kept] + bound[j]
        unit, kind = result.units[j], {"N": "force", "N m": "torque"}.get(result.units[j], "current")
        chart = Plot(
            (float(t[0]), float(t[-1])), span([*measured[kept], *low, *high]), "time in s", f"{kind} in {unit}",
            width=1040, height=220,
        )  # fmt: skip
        chart.band(t, low, high)
        chart.curve(t, measured[kept], INK)
        chart.curve(t, model[kept], AFTER)
        words = f"RMSE {significant(float(rms(measured - model)))} {unit}"
        figures.append(
            join(tag("h4", joint, tag("span", f"   {words}", class_="detail")), chart.svg(f"torque of {joint}"))
        )
    return join(figures)


def error_figures(result: Identification) -> Markup:
    """Distribution of the torque error of each axis, in N m and as a share of the torque limit (the papers' Figures 7, 8)."""
    judged = result.judged()
    errors = np.concatenate([p.measured - p.fitted for p in judged])
    size = rms(np.concatenate([p.measured for p in judged]))
    alike = len(set(result.units)) == 1  # newtons beside newton metres say nothing
    limited = bool(np.isfinite(result.effort).any())
    figures = [_boxes(result, errors, f"error in {result.unit}")] if alike else []
    if not alike or not limited:
        figures.append(_boxes(result, 100.0 * errors / size, "error in % of the joint's mean torque"))
    if limited:
        figures.append(_boxes(result, 100.0 * errors / result.effort, "error in % of the torque limit"))
    return tag("div", [tag("figure", f) for f in figures], class_="pair")


def _boxes(result: Identification, errors: Array, title: str) -> Markup:
    """Quartiles as a box, 5 and 95 % as whiskers, the extremes as dots."""
    n = len(result.joints)
    known = np.isfinite(errors).all(axis=0)
    spread = np.full((7, n), np.nan)
    spread[:, known] = np.percentile(errors[:, known], [0, 5, 25, 50, 75, 95, 100], axis=0)
    least, low, quarter, middle, three, high, most = spread
    shown = [v for v in [*(1.6 * low), *(1.6 * high)] if np.isfinite(v)]
    chart = Plot(
        (0.4, n + 0.6), span(shown, zero=True), "joint", title, width=520, height=300,
        x_marks=[(j + 1, str(j + 1)) for j in range(n)],
    )  # fmt: skip
    for j in range(n):
        if not np.isfinite(middle[j]):
            continue
        chart.bar(j + 1, low[j], high[j], SOFT)
        said = f"{result.joints[j]}: half of all errors within {significant(quarter[j])} ... {significant(three[j])}"
        chart.box((j + 0.75, j + 1.25), (quarter[j], three[j]), AFTER, said)
        chart.line([(j + 0.75, middle[j]), (j + 1.25, middle[j])], "var(--ground)", width=2)
        for extreme in (e for e in (least[j], most[j]) if chart.y[0] <= e <= chart.y[1]):
            chart.dot((j + 1, extreme), FAINT, size=2.5, title=f"extreme {significant(extreme)}")
    return chart.svg(title)


def speed_figures(result: Identification) -> Markup:
    """Mean error and its spread against speed, joint by joint: what is left of friction's structure."""
    judged, figures = result.judged(), []
    for j, joint in enumerate(result.joints):
        v = np.concatenate([p.velocity[:, j] for p in judged])
        error = np.concatenate([p.measured[:, j] - p.fitted[:, j] for p in judged])
        centre, mean, spread, low, high = binned(v, error)
        unit, turn = result.units[j], "m" if result.prismatic[j] else "rad"
        chart = Plot(
            span(centre), span([*(mean - spread), *(mean + spread)], zero=True), f"speed in {turn}/s", f"error in {unit}",
            width=520, height=240,
        )  # fmt: skip
        if len(centre) > 1:
            chart.band(centre, mean - spread, mean + spread)
            chart.line([(chart.x[0], 0.0), (chart.x[1], 0.0)], FAINT, width=1)
            chart.curve(centre, mean, AFTER)
            for x, a, b in zip(centre, low, high, strict=True):
                chart.bar(x, a, b, AFTER)
        figures.append(tag("figure", tag("h4", joint), chart.svg(f"error of {joint} against speed")))
    return tag("div", figures, class_="pair")


def binned(v: Array, error: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Centre speeds, mean errors, their standard deviations, and the means' own 95 % bounds, in bins of equal count.

    Neighbouring samples are alike: the bounds count a tenth of them.
    """
    order = np.argsort(v)
    bins = [b for b in np.array_split(order, _SPEED_BINS) if len(b) >= FEWEST]
    centre = np.array([float(np.median(v[b])) for b in bins], dtype=np.float64)
    mean = np.array([float(np.mean(error[b])) for b in bins], dtype=np.float64)
    spread = np.array([float(np.std(error[b])) for b in bins], dtype=np.float64)
    half = np.array([half_interval() * s / np.sqrt(max(len(b) / 10.0, 1.0)) for s, b in zip(spread, bins, strict=True)])
    half = np.asarray(half, dtype=np.float64)
    return centre, mean, spread, mean - half, mean + half


def validity_map(result: Identification) -> Markup:
    """Where the tool frame was while the model was judged, side view and from above, coloured by the relative error there."""
    judged = result.judged()
    reach = np.concatenate([p.reach for p in judged])
    error = np.concatenate([p.measured - p.fitted for p in judged])
    torque = np.concatenate([p.measured for p in judged])
    trained = np.concatenate([p.reach for p in result.training()]) if result.held_out() else None
    size = rms(torque)
    views = [
        ("from the side: distance from the base's axis and height, m", lambda r: (np.hypot(r[:, 0], r[:, 1]), r[:, 2])),
        ("from above: x and y, m", lambda r: (r[:, 0], r[:, 1])),
    ]
    figures = []
    for title, view in views:
        x, y = view(reach)
        where = [view(trained)] if trained is not None else []
        figures.append(tag("figure", tag("h4", title), _map(x, y, error, size, where)))
    return tag("div", figures, class_="pair")


def _map(x: Array, y: Array, error: Array, size: Array, trained: Sequence[tuple[Array, Array]]) -> Markup:
    every_x, every_y = (np.concatenate([a, *(t[k] for t in trained)]) for k, a in enumerate((x, y)))
    chart = Plot(span(every_x), span(every_y), width=520, height=420, equal=True)
    step = max(chart.x[1] - chart.x[0], chart.y[1] - chart.y[0]) / _CELLS
    for tx, ty in trained:
        for a, b in sorted(set(zip(np.floor(tx / step).tolist(), np.floor(ty / step).tolist(), strict=True))):
            chart.box((a * step, (a + 1) * step), (b * step, (b + 1) * step), "var(--wash)", "fitted here, not judged")
    column, row = np.floor(x / step), np.floor(y / step)
    share = rms(error / size, axis=1)
    overall = float(rms(share))
    for a, b in sorted(set(zip(column.tolist(), row.tolist(), strict=True))):
        here = (column == a) & (row == b)
        if np.count_nonzero(here) < FEWEST:
            continue
        local = float(rms(share[here]))
        worse = local > 1.5 * overall
        strength = min(max(local / (3.0 * overall), 0.12), 0.9)
        colour = f"rgba(214, 120, 20, {strength:.2f})" if worse else f"rgba(var(--accent), {strength:.2f})"
        said = f"{100 * local:.1f} % of the torque, {np.count_nonzero(here)} samples"
        chart.box((a * step, (a + 1) * step), (b * step, (b + 1) * step), colour, said)
    return chart.svg("where the model was judged")
