# SPDX-License-Identifier: Apache-2.0
"""The sections of an identification's report, in the order of the questions that an arm engineer asks."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from trueup.identification.estimation.result import (
    Deliverable,
    Identification,
    Parameter,
    relative_error,
    relative_errors,
    rmse,
)
from trueup.report.identification_figures import error_figures, speed_figures, torque_figures, validity_map
from trueup.report.identification_files import files_section
from trueup.report.markup import Markup, breakable, join, tag
from trueup.report.numbers import duration_text, fixed, significant, supported_decimals
from trueup.report.parts import (
    Section,
    callout,
    caption,
    cells,
    chip,
    context_table,
    facts,
    head,
    hero,
    row,
    sentences,
    table,
)  # fmt: skip

VERDICTS = {
    "identified": "known to 10 % or better (standard deviation, with the errors' memory)",
    "roughly": "known to 50 % or better",
    "small": "adds less than 2 % of a joint's torque in these motions: of no consequence there",
    "shared": "predicts together with the joint's other effects; alone it is not certain",
    "not seen": "these motions cannot tell it: do not read the value as a measurement",
}


def identification_sections(
    result: Identification, delivered: Sequence[Deliverable], context: Mapping[str, str]
) -> tuple[Section, ...]:
    """All sections; `delivered` are the files beside the report."""
    shown = result.judged()[0]
    parts = [
        Section("answer", "How good", "How well does it predict torque?", _answer(result)),
        *([Section("files", "Files", "Which file is for what, and how good is each?", files_section(result, delivered))]
          if delivered else []),
        Section("torque", "Torque", f"Torque, measured and predicted: {shown.recording}", join(
            tag("p", "Black: measured. Blue: predicted, with a band of one root mean squared error either side. ",
                "Held out: the model never saw this motion." if shown.held_out else "This motion was fitted."),
            torque_figures(result, shown),
        )),
        Section("errors", "Errors", "How are the errors distributed, axis by axis?", join(
            error_figures(result),
            caption("Box: half of all errors. Line: 90 %. Dots: extremes, where they fit. Joints are numbered in the "
                    "model's order."),
        )),
        Section("friction", "Friction", "Does friction have structure that is left?", _friction(result)),
        Section("parameters", "Parameters", "What are the numbers, and how sure are they?", _parameters(result)),
        *([Section("links", "Bodies", "Can these bodies exist?", _links(result))] if result.links else []),
        Section("validity", "Where it holds", "Where was the model verified?", _validity(result)),
        Section("missing", "What is missing", "What could these recordings not tell, and which motion would?",
                _missing(result)),
        Section("details", "Details", "How was this done?", _details(result, context)),
    ]  # fmt: skip
    return tuple(parts)


def _answer(result: Identification) -> Markup:
    judged, held = result.judged(), bool(result.held_out())
    label = "error on motion that was held out" if held else "error on the training data: nothing was held out"
    number = join(tag("span", f"{100 * relative_error(judged):.2f}", class_="after" if held else "before"),
                  tag("span", " % of the torque", class_="unit"))  # fmt: skip
    beside = [("fitted", f"{100 * relative_error(result.training()):.2f} %")]
    by_file = relative_error(judged, "file")
    if math.isfinite(by_file) and set(result.units) <= {"N m", "N"}:  # a file tells no current
        beside.append(("by the model file as it was given", f"{100 * by_file:.0f} %"))
    if math.isfinite(result.cross_validated()):
        beside.append(("cross-validated, all joints", f"{significant(result.cross_validated())} {result.unit}"))
    mind = [callout("warn" if held else "bad", "Mind", sentence) for sentence in result.warnings]
    return join(hero(label, number, facts(beside, "hero-facts")), mind, _joint_table(result))


def _joint_table(result: Identification) -> Markup:
    judged = result.judged()
    errors, shares = rmse(judged), relative_errors(judged)
    rows = []
    for j, joint in enumerate(result.joints):
        limit = result.effort[j]
        numbers = cells(
            f"{significant(errors[j])} {result.units[j]}",
            f"{100 * shares[j]:.1f} %",
            f"{100 * errors[j] / limit:.2f} %" if np.isfinite(limit) else "–",
        )
        rows.append(row(breakable(joint), numbers, cells(", ".join(result.structure[j]), kind="words")))
    titles = ("Joint", "RMSE", "of its torque", "of its limit", "Effects kept")
    return table(head(*titles, numbers=range(1, 4)), rows, "compact")


def _friction(result: Identification) -> Markup:
    return join(
        tag("p", "Mean error against speed, with the mean's own 95 % bars and the spread of the errors as a band. A mean "
            "that leaves zero where its bars do not reach it is friction that the model lacks."),
        speed_figures(result),
    )  # fmt: skip


def _parameters(result: Identification) -> Markup:
    counts = Counter(p.verdict for p in result.parameters)
    told = ", ".join(f"{counts[v]} {v}" for v in VERDICTS if counts[v])
    titles = ("Parameter", "Joint", "Value", "Standard deviation", "File as given", "File written", "Unit", "Verdict")
    rows = table(
        head(*titles, numbers=range(2, 6)), [_parameter(p) for p in result.parameters], "compact", id="numbers"
    )
    return join(
        tag("p", f"{len(result.parameters)} combinations and effects were fitted: {told}."),
        facts([(chip(v), VERDICTS[v]) for v in VERDICTS if counts[v]], "legend"),
        tag(
            "details",
            tag("summary", f"All {len(result.parameters)} parameters"),
            _symbols(result),
            rows,
        ),
    )


def _symbols(result: Identification) -> Markup:
    """What the names of parameters mean."""
    numbered = ", ".join(f"{j} {joint}" for j, joint in enumerate(result.joints, 1))
    known = (
        ("numbers", f"joints, and the links that they move: {numbered}"),
        ("m2, mc2x, I2zz", "mass of link 2, mass times its centre, second moment about the origin of the joint's frame, in "
                           "combinations that torque can tell"),
    )  # fmt: skip
    symbols: dict[str, str] = {}
    for p in result.parameters:
        if p.note:
            symbols.setdefault(p.note, re.sub(r"(?<=[a-z])\d+\..*", "", p.name.split("_")[0]))
    return facts([*known, *((name, note) for note, name in symbols.items())], "legend symbols")


def _parameter(p: Parameter) -> Markup:
    decimals = supported_decimals(p.value, p.value - p.deviation, p.value + p.deviation)
    said = f"{p.verdict} to {significant(100 * p.relative, 2)} %" if p.verdict == "identified" else p.verdict

    def number(value: float) -> str:
        return fixed(value, decimals)

    return row(
        tag("span", p.name, class_="parameter"), cells(breakable(p.joint), kind=""),
        cells(number(p.value), kind="number value"), cells(number(p.deviation)), cells(number(p.file), kind="number start"),
        cells(number(p.consistent)), cells(p.unit, kind="unit"), cells(chip(p.verdict, said), kind=""),
    )  # fmt: skip


def _links(result: Identification) -> Markup:
    edges = [link.name for link in result.links if link.on_boundary]
    rows = []
    for link in result.links:
        x, y, z = (fixed(1e3 * c, 1) for c in link.com)
        state = chip("impossible", "on the edge") if link.on_boundary else chip("identified", "possible")
        unconstrained = f"unconstrained: {link.violation}" if link.violation else ""
        moments = ", ".join(significant(m) for m in link.moments)
        numbers = cells(significant(link.mass), f"{x}, {y}, {z}", moments)
        rows.append(row(breakable(link.name), numbers, cells(state, kind=""), cells(unconstrained, kind="words")))
    titles = ("Link", "Mass, kg", "Centre of mass, mm", "Principal moments, kg m²", "", "")
    words = (
        "Torque tells only combinations of these numbers; what it cannot tell comes from the model file. Every link is a "
        "mass distribution without negative mass, so a simulator can run it."
    )
    told = f" The fit stopped at the edge of what is possible for {', '.join(edges)}." if edges else ""
    return join(tag("p", words + told), table(head(*titles, numbers=range(1, 4)), rows, "compact", id="links"))


def _validity(result: Identification) -> Markup:
    judged = result.judged()
    q, v = (np.concatenate([getattr(p, name) for p in judged]) for name in ("position", "velocity"))
    rows = []
    for j, joint in enumerate(result.joints):
        angle, unit = (1.0, "m") if result.prismatic[j] else (math.degrees(1.0), "deg")
        low, high, fastest = (angle * float(x) for x in (q[:, j].min(), q[:, j].max(), np.abs(v[:, j]).max()))
        numbers = cells(f"{fixed(low, 1)} … {fixed(high, 1)} {unit}", f"{fixed(fastest, 1)} {unit}/s")
        rows.append(row(breakable(joint), numbers))
    kind = "was held out" if result.held_out() else "was fitted (nothing was held out)"
    return join(
        tag("p", f"Where the last link's frame went in the motion that {kind}; darker is a larger error, orange is more than "
            "1.5 times the mean one. Pale cells were fitted but not judged. Outside, the model is extrapolation."),
        validity_map(result),
        table(head("Joint", "Positions", "Speeds up to", numbers=(1, 2)), rows, "compact pairs"),
    )  # fmt: skip


def _missing(result: Identification) -> Markup:
    if not result.advice:
        return tag("p", "Every combination that matters for torque was seen.")
    return sentences(result.advice)


def _details(result: Identification, context: Mapping[str, str]) -> Markup:
    a = result.alignment
    told = {
        "Filter": f"zero-phase Butterworth of order 8 at {result.cutoff:g} Hz, torque and regressor alike; compared at "
        f"{result.rate:.4g} Hz",
        "Weights": result.weighting,
        "Clocks": "not compared" if a is None else (
            f"torque comes {1e3 * a.shift:.2f} ± {1e3 * a.deviation:.2f} ms late ({a.samples:.2g} samples of the log); "
            + ("corrected" if a.corrected else "not corrected")
        ),
        "Pull towards the model file": f"{result.trust:.0e}; for possible bodies {result.pull:.0e}",
        "Cross-validation": f"{len(result.cross_validation)} blocks of time, each predicted from the others; effects "
        "were chosen by the same blocks, so this number is a little kind",
        "Computed in": duration_text(result.seconds),
        **context,
    }  # fmt: skip
    notes = sentences(result.notes) if result.notes else None
    return join(notes, context_table({k: tag("code", v) if k in context else v for k, v in told.items()}))
