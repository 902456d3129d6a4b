# SPDX-License-Identifier: Apache-2.0
"""The page of the study, for those who want the whole: the paper's figure and table, and what goes beyond them."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from string import Template

from trueup.discrepancies.path_shape import READINGS
from trueup.formats.aside import write_aside
from trueup.report.markup import Child, Markup, escape, join, tag
from trueup.report.plots import AFTER, BEFORE
from trueup.studies.stanley import chasi
from trueup.studies.stanley.figures import course_shapes, deviation, figure_four, profile_plots, squared, trace
from trueup.studies.stanley.paper import BAND, SPACING
from trueup.studies.stanley.study import Study
from trueup.studies.stanley.table import PAPER_SIMULATION, costs, improvement


def write_study_report(study: Study, path: Path) -> Path:
    """Writes the report and returns where. Raises OutputError; an older report is untouched then."""
    write_aside(study_html(study), path)
    return path


def study_html(study: Study) -> str:
    """The report as the text of an HTML document."""
    parts = (
        ("better", "Better?", "Does the robot drive better?", _headline(study)),
        ("figure", "Figure 4", "What happened, panel by panel", _figure(study)),
        ("table", "Table III", "What it gained and what it cost", _table(study)),
        ("profiles", "What is seen", "Which parameters can the recorded drive tell?", _profiles(study)),
        ("rounds", "In rounds", "Beyond the paper: calibrated instant by instant, tuned under doubt", _rounds(study)),
        ("noise", "Noise", "Beyond the paper: localisation noise among the parameters", _noise(study)),
        ("courses", "Other courses", "Beyond the paper: do the gains hold on other paths?", _courses(study)),
    )
    templates = resources.files("trueup.report").joinpath("templates")
    page = templates.joinpath("campaign.html").read_text(encoding="utf-8")
    trials = len(study.paper.calibration.losses) + len(study.paper.tuning.losses)
    return Template(page).substitute(
        title=escape("Stanley gains for a carrying robot"),
        style=templates.joinpath("report.css").read_text(encoding="utf-8"),
        subtitle=escape(f"{trials} simulated runs of {chasi.DURATION:.0f} s in {study.paper_seconds:.1f} s"),
        contents=join(tag("a", short, href=f"#{key}") for key, short, _, _ in parts),
        sections=join(tag("section", tag("h2", title), body, id=key) for key, _, title, body in parts),
    )


def _headline(study: Study) -> Markup:
    initial, paper, rounds = study.errors
    rows = [
        ("initial gains (1, 1, 1)", _mm(initial), "", "1 run"),
        ("the paper's way: five parameters by time warping, three gains", _mm(paper), _percent(initial, paper), "2 runs"),
        ("in rounds: calibrated instant by instant, gains and lead tuned under doubt", _mm(rounds),
         _percent(initial, rounds), f"{len(study.rounds.trials)} runs"),
    ]  # fmt: skip
    words = (
        "Distance of the steered axle from the path, root mean square along it, as it truly is (localisation aside)."
    )
    return join(tag("p", words), table(("", "distance", "less by", "robot"), rows))


def _figure(study: Study) -> Markup:
    space = chasi.simulator(study.paper.calibration.names, 0.0, 0.0).parameters
    gains = chasi.task(gains=study.paper.tuning.names).parameters
    runs = [("initial gains", study.paper.robot_before, BEFORE), ("tuned", study.paper.robot_after, AFTER)]
    return join(
        figure_four(study.paper, space, gains),
        tag(
            "figure",
            tag("figcaption", "The robot's distance from its path along the run"),
            deviation(study.paper.desired, runs),
        ),
        tag("figure", tag("figcaption", "The trials of the calibration"), trace(study.paper.calibration)),
        tag("figure", tag("figcaption", "The trials of the tuning"), trace(study.paper.tuning)),
    )


def _table(study: Study) -> Markup:
    paper = study.paper
    calibration, tuning = len(paper.calibration.losses), len(paper.tuning.losses)
    each = (paper.calibration.seconds + paper.tuning.seconds) / (calibration + tuning)
    ours, theirs = costs(calibration, tuning, each), costs(324, 116, PAPER_SIMULATION)
    before, after = paper.scores
    rows = [("distance by arc length, rms", _mm(before), _mm(after), _percent(before, after), "")]
    for reading in ("accumulated", "joint", "separate", "mean"):
        b, a = paper.tracking(reading)
        unit, factor = {"accumulated": ("m", 1.0), "mean": ("mm", 1e3)}.get(reading, ("mm²", 1e6))
        there = "3.72 → 1.82 (51.08 %)" if reading == "accumulated" else ""
        rows.append(
            (f"2D-DTW, {reading}", f"{factor * b:.4g} {unit}", f"{factor * a:.4g} {unit}", _percent(b, a), there)
        )
    rows += [
        ("time, hours", f"{ours.robot_hours:.2f}", f"{ours.simulation_hours:.4f}", f"{ours.saved[0]:.2f} saved",
         f"{theirs.robot_hours:.2f} → {theirs.simulation_hours:.2f} ({theirs.saved[0]:.2f})"),
        ("energy, kWh", f"{ours.robot_energy:.2f}", f"{ours.simulation_energy:.6f}", f"{ours.saved[1]:.3f} saved",
         f"{theirs.robot_energy:.2f} → {theirs.simulation_energy:.3f} ({theirs.saved[1]:.3f})"),
    ]  # fmt: skip
    notes = [tag("li", f"{name}: {squared(what)}") for name, what in READINGS.items()]
    words = (
        f"Tracking of the robot as it was measured; paths warped every {100 * SPACING:.0f} cm within {100 * BAND:.0f} % of "
        f"their length. The paper's figure has no unit. One simulated run took {1e3 * each:.1f} ms, sampler and loss "
        f"included (the paper: {PAPER_SIMULATION:.0f} s). The two runs that the method needs of the robot take "
        f"{ours.real_runs_hours:.2f} h, which the paper leaves out."
    )
    return join(table(("", "initial / on the robot", "tuned / simulated", "better by", "the paper"), rows), tag("p", words),
                tag("ul", notes, class_="sentences"))  # fmt: skip


def _profiles(study: Study) -> Markup:
    words = (
        "The loss along each parameter, the others as found, over its least value. Blue: by time warping, as in the paper; "
        "orange: at the same instants. Where the blue line stays below the dashed one, the warped path cannot tell."
    )
    return join(tag("p", words), profile_plots(study.profiles))


def _rounds(study: Study) -> Markup:
    rows: list[Sequence[Child]] = []
    for number, one in enumerate(study.rounds.rounds, 1):
        if one.chosen is None or one.validated is None:
            continue
        seen = zip(one.transferred, one.validated.predicted, one.validated.measured, strict=True)
        for k, (tried, said, was) in enumerate(seen):
            label = "the best so far" if k == one.chosen.incumbent else f"candidate {k}"
            rows.append((f"{number}", label, _gains(study.rounds.settings(tried.unit).values()), _mm(said), _mm(was)))
    e = next(r.calibrated for r in reversed(study.rounds.rounds) if r.calibrated is not None)
    each = zip(e.names, e.values, e.units, e.fitted, e.low, e.high, e.verdicts, strict=True)
    numbers = [
        (name.replace("_", " "), f"{value:.4g} {squared(unit)}", f"{low:.4g} ... {high:.4g}" if fitted else "", verdict)
        for name, value, unit, fitted, low, high, verdict in each
    ]
    words = (
        "Recorded drives cut into windows of 6 s and replayed under the commands that were sent, compared instant by "
        "instant. Candidates are judged on samples of what the calibration leaves unsure; several go to the robot, beside "
        "the best so far."
    )
    return join(
        tag("p", words), table(("round", "", "k1, k2, k3, lead", "simulated", "on the robot"), rows),
        tag("h3", "What the last calibration found"), table(("parameter", "value", "95 % interval", ""), numbers),
    )  # fmt: skip


def _noise(study: Study) -> Markup:
    found = dict(zip(study.noise.names, study.noise.best, strict=True))
    rows = [
        ("position", f"{1e3 * found['position_noise']:.2f} mm", f"{1e3 * study.noise_truth[0]:.2f} mm"),
        ("heading", f"{1e3 * found['heading_noise']:.2f} mrad", f"{1e3 * study.noise_truth[1]:.2f} mrad"),
    ]
    others = ", ".join(f"{n.replace('_', ' ')} {found[n]:.3g}" for n in study.paper.calibration.names)
    words = (
        "The same search with two more parameters. The loss also compares how restless the measured pose is from sample to "
        f"sample, which the path alone hardly shows. The others then come out as: {others}."
    )
    return join(tag("p", words), table(("noise of", "calibrated", "truth"), rows))


def _courses(study: Study) -> Markup:
    c = study.courses
    today, one, several = c.summary
    rows = [
        (
            name,
            _gains(gains),
            *(f"{1e3 * e:.1f}" for e in errors[c.trained :]),
            f"{1e3 * mean:.1f}",
            f"{1e3 * most:.1f}",
        )
        for name, gains, errors, mean, most in zip(c.rows, c.gains, c.errors, c.held_out, c.worst, strict=True)
    ]
    head = ("", "k1, k2, k3, lead", *(p.name.split(",")[0] for p in c.courses[c.trained :]), "mean", "worst")
    words = (
        f"Courses drawn from one distribution of shapes, curvatures and speeds: {c.trained} to train on, "
        f"{len(c.courses) - c.trained} held out. The simulator was calibrated on one run of each of the former with today's "
        "gains; gains were tuned on one of them or on all, with as many simulated runs and as many runs of the robot, which "
        "chose among what the simulator proposed. A course shows the gain of the speeds that it is driven at; what it does "
        "not show is left to chance."
    )
    told = (
        f"True distance from the held-out courses in mm, rms; the mean is the geometric one. Tuned on all it is "
        f"{1e3 * several:.1f} mm, on one of them {1e3 * one:.1f} mm; with today's gains {1e3 * today:.1f} mm."
    )
    return join(tag("p", words), course_shapes(c.courses, c.trained), tag("p", told), table(head, rows))


def table(head: Sequence[Child], rows: Sequence[Sequence[Child]]) -> Markup:
    """A table whose first column names the rows."""
    top = tag("tr", [tag("th", h) for h in head])
    body = [tag("tr", tag("th", row[0], scope="row"), [tag("td", cell) for cell in row[1:]]) for row in rows]
    return tag("div", tag("table", tag("thead", top), tag("tbody", body), class_="rounds"), class_="scroll")


def _gains(values: object) -> str:
    return ", ".join(f"{float(v):.2f}" for v in values)  # type: ignore[attr-defined]


def _mm(error: float) -> str:
    return f"{1e3 * error:.1f} mm"


def _percent(before: float, after: float) -> str:
    return f"{improvement(before, after):.1f} %"
