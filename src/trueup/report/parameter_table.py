# SPDX-License-Identifier: Apache-2.0
"""Third section: what are the numbers, and how sure are they?"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

from trueup.calibration import Calibration, Estimate
from trueup.report.marks import spans_decades
from trueup.report.markup import Markup, breakable, join, tag
from trueup.report.numbers import fixed, supported_decimals
from trueup.report.parts import caption, chip, empty, facts, table

VERDICTS = {
    "identified": "these recordings determine it within the interval",
    "tied": "only the combination named beside it is determined, not how it is shared; or its ratio to masses",
    "effective": "replays best, but stands for something too that the model lacks",
    "weak": "only roughly determined: the interval is wide",
    "at bound": "the fit stopped at a bound: widen the bounds, or doubt the model",
    "not identified": "these recordings cannot tell it: do not read the value as a measurement",
    "no effect": "changing it changed nothing in these recordings",
    "not supported": "fitting it did not pay, so it stayed at its start",
    "frozen": "given, applied to the model, not searched",
}
"""Every verdict with what it means, in the order of the legend."""


def parameter_table(calibration: Calibration) -> Markup:
    """A sentence, chips that filter, and the table; JavaScript makes it sortable."""
    estimates = calibration.estimates
    if not estimates:
        return empty("The calibration has no parameters.")
    counts = Counter(e.verdict for e in estimates)
    titles = tag(
        "tr",
        _header("Parameter"),
        _header("Start", "number"),
        _header("Value", "number"),
        _header("95 % interval", "number"),
        tag("th", "Unit", scope="col"),
        _header("Within its bounds", "bars"),
        _header("Verdict"),
    )
    text = (
        "The band is the 95 % interval, the dot the value, the ring the start; the track runs from the lower to the "
        "upper bound. Value and interval carry as many digits as the interval supports."
    )
    return join(
        tag("p", counted_sentence(estimates)),
        _filters(counts),
        table(titles, [_row(e) for e in estimates], id="parameters"),
        caption(text),
        _legend(counts),
    )


def counted_sentence(estimates: Sequence[Estimate]) -> str:
    """How many were fitted and what became of them, plain text."""
    fitted = [e for e in estimates if e.fitted]
    counts = Counter(e.verdict for e in fitted)
    order = [*VERDICTS, *(v for v in counts if v not in VERDICTS)]
    parts = ", ".join(f"{counts[v]} {v}" for v in order if counts[v])
    kept = len(estimates) - len(fitted)
    rest = f" {kept} {'was' if kept == 1 else 'were'} applied but not fitted." if kept else ""
    if not fitted:
        return f"None of the {len(estimates)} parameters was fitted."
    return (
        f"Of {len(estimates)} parameters {len(fitted)} {'was' if len(fitted) == 1 else 'were'} fitted: {parts}.{rest}"
    )


def verdict_chip(verdict: str, count: int | None = None) -> Markup:
    """The verdict as a small coloured label, with how many have it."""
    words = verdict if count is None else f"{verdict} {count}"
    return chip(verdict, words, kind=verdict if verdict in VERDICTS else "frozen")


def bounds_bar(estimate: Estimate) -> Markup | None:
    """Start, value and interval on a track between the bounds; None where nothing is known to draw."""
    low, high = _track(estimate)
    if not low < high:
        return None
    log = spans_decades(low, high)
    ends = (math.log(low), math.log(high)) if log else (low, high)

    def percent(x: float) -> float:
        if log:
            x = math.log(max(x, low))
        return 3 + 94 * min(max((x - ends[0]) / (ends[1] - ends[0]), 0.0), 1.0)

    parts = [tag("line", x1="3%", x2="97%", y1="10", y2="10", class_="track")]
    if estimate.low < estimate.high:
        left, right = percent(estimate.low), percent(estimate.high)
        width = max(right - left, 0.8)
        parts.append(tag("rect", x=f"{left:.2f}%", y="6", width=f"{width:.2f}%", height="8", rx="2", class_="interval"))
    if math.isfinite(estimate.start):
        parts.append(tag("circle", cx=f"{percent(estimate.start):.2f}%", cy="10", r="4", class_="start"))
    if math.isfinite(estimate.value):
        parts.append(tag("circle", cx=f"{percent(estimate.value):.2f}%", cy="10", r="3.5", class_="value"))
    decimals = supported_decimals(high, low, math.nan)
    title = f"bounds {fixed(low, decimals)} to {fixed(high, decimals)} {estimate.unit}" + (
        ", logarithmic" if log else ""
    )
    return tag("svg", tag("title", title), parts, width="100%", height="20", role="img")


def _track(estimate: Estimate) -> tuple[float, float]:
    """The bounds, or where one is infinite as far as start, value and interval reach."""
    known = [x for x in (estimate.start, estimate.value, estimate.low, estimate.high) if math.isfinite(x)]
    margin = 0.1 * (max(known) - min(known)) if known else 0.0
    low, high = estimate.lower_bound, estimate.upper_bound
    if not math.isfinite(low):
        low = min(known, default=0.0) - margin
    if not math.isfinite(high):
        high = max(known, default=0.0) + margin
    return low, high


def _header(title: str, kind: str | None = None) -> Markup:
    return tag("th", tag("button", title, type="button"), scope="col", class_=kind, aria_sort="none")


def _row(estimate: Estimate) -> Markup:
    e = estimate
    sure = e.fitted and math.isfinite(e.low) and math.isfinite(e.high)
    decimals = supported_decimals(e.value, e.low, e.high) if sure else supported_decimals(e.value, math.nan, math.nan)
    value = "none" if e.absent else fixed(e.value, decimals) if sure or e.fitted else _plain(e.value)
    interval = join(fixed(e.low, decimals), " … ", fixed(e.high, decimals)) if e.low == e.low and e.fitted else "–"
    name = join(
        tag("span", breakable(e.name), class_="parameter"), tag("small", e.note, class_="note") if e.note else None
    )
    order = list(VERDICTS).index(e.verdict) if e.verdict in VERDICTS else len(VERDICTS)
    return tag(
        "tr",
        tag("th", name, scope="row", data_sort=e.name),
        tag("td", _plain(e.start), class_="number start", data_sort=_sortable(e.start)),
        tag("td", value, class_="number value", data_sort=_sortable(e.value)),
        tag("td", interval, class_="number interval", data_sort=_sortable(_relative_width(e))),
        tag("td", e.unit, class_="unit"),
        tag("td", bounds_bar(e), class_="bars", data_sort=_sortable(_place(e))),
        tag("td", verdict_chip(e.verdict), data_sort=str(order)),
        data_verdict=e.verdict,
    )


def _plain(value: float) -> str:
    """A number that somebody gave: up to four digits, no zeros added."""
    if not math.isfinite(value):
        return fixed(value, 0)
    text = fixed(value, supported_decimals(value, math.nan, math.nan))
    return text.rstrip("0").rstrip(".") if "." in text and "·" not in text else text


def _relative_width(estimate: Estimate) -> float:
    return (estimate.high - estimate.low) / abs(estimate.value) if estimate.value else math.nan


def _place(estimate: Estimate) -> float:
    low, high = _track(estimate)
    return (estimate.value - low) / (high - low) if low < high else math.nan


def _sortable(value: float) -> str:
    return repr(float(value)) if math.isfinite(value) else ""


def _filters(counts: Counter[str]) -> Markup:
    order = [v for v in (*VERDICTS, *(c for c in counts if c not in VERDICTS)) if counts[v]]
    chips = [
        tag("button", verdict_chip(v, counts[v]), type="button", aria_pressed="true", data_verdict=v, class_="toggle")
        for v in order
    ]
    search = tag(
        "input", type="search", id="parameter-filter", placeholder="Filter by name or note", aria_label="Filter"
    )
    return tag("div", search, tag("div", chips, class_="toggles") if len(chips) > 1 else None, class_="controls")


def _legend(counts: Counter[str]) -> Markup:
    return facts([(verdict_chip(v), text) for v, text in VERDICTS.items() if counts[v]], "legend")
