# SPDX-License-Identifier: Apache-2.0
"""The figures of the study: the six panels of the paper's Figure 4, search traces, loss profiles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from trueup.arrays import Array
from trueup.parameters import ParameterSpace
from trueup.paths import Path
from trueup.report.markup import Markup, join, tag
from trueup.report.numbers import fixed
from trueup.report.plots import AFTER, BEFORE, INK, SOFT, Plot, span
from trueup.samples import between, way_along
from trueup.studies.stanley.paper import PaperStudy, Searched
from trueup.studies.stanley.profile import FLAT, Profile

_THIN = 4  # every so many-th sample is drawn


def squared(unit: str) -> str:
    """A unit as it is read: m/s², not m/s^2."""
    return unit.replace("^2", "²")


def course_map(lines: Sequence[tuple[str, Array, str]], desired: Array) -> Markup:
    """Paths over one another on the floor, the desired one dashed; `lines` are name, (n, 2) in m, colour."""
    everything = np.concatenate([desired, *(p for _, p, _ in lines)])
    plot = Plot(span(everything[:, 0]), span(everything[:, 1]), "x, m", "y, m", width=720, height=230, equal=True)
    plot.line(desired, SOFT, width=1.0, dashed=True)
    for _, path, colour in lines:
        plot.line(path[::_THIN], colour, width=1.3)
    named = [tag("b", name, style=f"color:{colour}") for name, _, colour in lines]
    legend = tag("p", "dashed: desired path", [join(" · ", n) for n in named], class_="caption")
    return join(legend, plot.svg("; ".join(name for name, _, _ in lines)))


def course_shapes(courses: Sequence[Path], trained: int) -> Markup:
    """A small map of each course, those held out in grey."""
    figures = []
    for k, course in enumerate(courses):
        plot = Plot(span(course.points[:, 0]), span(course.points[:, 1]), width=215, height=190, equal=True)
        plot.line(course.points[::_THIN], AFTER if k < trained else SOFT, width=1.6)
        plot.line(course.points[:8], INK, width=4.0)
        name = f"course {k + 1}: {course.name}" if k < trained else f"held out: {course.name}"
        figures.append(tag("figure", tag("figcaption", name, class_="caption"), plot.svg(name), style="margin:0"))
    return tag("div", figures, style="display:grid;grid-template-columns:repeat(auto-fill,minmax(200px,1fr));gap:8px")


def changes(searched: Searched, space: ParameterSpace) -> Markup:
    """Start and found values of each parameter within its range."""
    start, found = space.to_unit(searched.start), space.to_unit(searched.best)
    count = len(searched.names)
    marks = [(float(k), name.replace("_", " ")) for k, name in enumerate(searched.names)]
    plot = Plot((-0.5, count - 0.5), (0.0, 1.0), "", "share of its range", width=720, height=250, x_marks=marks)
    for k, p in enumerate(space.parameters):
        plot.line([(k, start[k]), (k, found[k])], SOFT, width=1.0)
        moved = abs(found[k] - start[k]) > 0.05
        for place, value, colour in ((start[k], searched.start[k], BEFORE), (found[k], searched.best[k], AFTER)):
            plot.dot((k, float(place)), colour, title=f"{p.name}: {value:.3g} {squared(p.unit)}")
            if moved or colour == AFTER:
                plot.text((k + 0.06, float(place)), f"{value:.3g} {squared(p.unit)}", colour)
    return plot.svg("parameters before and after")


def figure_four(study: PaperStudy, calibrated: ParameterSpace, gains: ParameterSpace) -> Markup:
    """Panels (a) to (f) of the paper's Figure 4."""
    desired = study.desired
    panels = (
        ("(a) the robot with its initial gains", course_map([("robot", study.robot_before, BEFORE)], desired)),
        ("(b) the simulator before and after calibration, same gains", course_map(
            [("robot", study.robot_before, INK), ("default", study.default, BEFORE),
             ("calibrated", study.calibrated, AFTER)], desired)),
        ("(c) simulator parameters before and after", changes(study.calibration, calibrated)),
        ("(d) the calibrated simulator with initial and tuned gains", course_map(
            [("initial gains", study.calibrated, BEFORE), ("tuned", study.tuned, AFTER)], desired)),
        ("(e) gains before and after", changes(study.tuning, gains)),
        ("(f) the robot with initial and tuned gains", course_map(
            [("initial gains", study.robot_before, BEFORE), ("tuned", study.robot_after, AFTER)], desired)),
    )  # fmt: skip
    return join(tag("figure", tag("figcaption", words), body) for words, body in panels)


def deviation(path: Array, runs: Sequence[tuple[str, Array, str]]) -> Markup:
    """Distance from the path along it, in mm: where errors come from."""
    lines = []
    arc = way_along(path)
    fine = np.arange(0.0, arc[-1], 0.005)
    dense = KDTree(between(fine, arc, path))
    for _, driven, colour in runs:
        lines.append((way_along(driven[::_THIN]), 1e3 * np.asarray(dense.query(driven[::_THIN])[0]), colour))
    gone, gaps = (span(np.concatenate(values).tolist(), zero=True) for values in list(zip(*lines, strict=True))[:2])
    plot = Plot(gone, gaps, "driven, m", "measured distance, mm", height=240)
    for way, off, colour in lines:
        plot.curve(way, off, colour, width=1.2)
    return plot.svg("distance from the path")


def trace(searched: Searched) -> Markup:
    """Losses of the trials of a search, and the best so far."""
    best = np.minimum.accumulate(np.where(np.isfinite(searched.losses), searched.losses, np.inf))
    top = float(np.nanquantile(searched.losses, 0.9))
    plot = Plot((0, len(best)), (0.0, top * 1e6), "trial", "loss, mm²", height=220)
    for k, loss in enumerate(searched.losses):
        if loss <= top:
            plot.dot((k, 1e6 * float(loss)), SOFT, size=1.6)
    plot.line(enumerate(1e6 * best), AFTER)
    return plot.svg("search trace")


def profile_plots(rows: Sequence[Profile]) -> Markup:
    """One small plot a parameter: both losses over their least ones, and what is found."""
    drawn = []
    for p in rows:
        warped, timed = p.warped / p.warped.min(), p.timed / p.timed.min()
        plot = Plot(
            span(p.values, margin=0.0),
            (0.9, 3.0),
            f"{p.name.replace('_', ' ')}, {squared(p.unit)}",
            "loss / least",
            360,
            220,
        )
        for values, colour in ((timed, BEFORE), (warped, AFTER)):
            plot.curve(p.values, np.minimum(values, 3.0), colour)
        plot.line([(p.values[0], FLAT), (p.values[-1], FLAT)], SOFT, dashed=True, width=0.8)
        plot.dot((p.found, 1.0), INK)
        words = f"{p.verdict} (as good over {fixed(100 * p.open_share[0], 0)} % of its range)"
        drawn.append(tag("figure", plot.svg(p.name), tag("figcaption", words)))
    return tag("div", drawn, class_="figures")
