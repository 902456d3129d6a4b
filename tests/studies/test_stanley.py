# SPDX-License-Identifier: Apache-2.0
"""The Stanley study: the paper's arithmetic, calibrations that find what is hidden, a robot that drives better."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from pages import checked
from rich.console import Console

from trueup.campaign.drives import doubted
from trueup.campaign.kinds import drives as calibrate_drives
from trueup.commands.study_view import study_table
from trueup.engines.vehicle import BETAS
from trueup.errors import UnknownNameError
from trueup.recording import Recording
from trueup.studies.stanley import chasi
from trueup.studies.stanley.courses import across_courses, drawn_courses, true_errors
from trueup.studies.stanley.paper import PaperStudy, calibrate_betas, paper_study
from trueup.studies.stanley.profile import profiles
from trueup.studies.stanley.rounds import in_rounds
from trueup.studies.stanley.run import run_study
from trueup.studies.stanley.table import costs, improvement
from trueup.tasks.task import robot_trials
from trueup.tracking.windows import noise_of, windows


@pytest.fixture(scope="module")
def drive() -> Recording:
    """Stand-in 1 with its initial gains."""
    task = chasi.task()
    return chasi.robot(1).perform(robot_trials(task, task.parameters.nominal)[0])[0]


@pytest.fixture(scope="module")
def study() -> PaperStudy:
    return paper_study(chasi.robot(1), calibration_trials=90, tuning_trials=40)


def test_table_iii_follows_from_its_formulas() -> None:
    paper = costs(324, 116, 45.0)
    assert (round(paper.robot_hours, 2), round(paper.simulation_hours, 2)) == (9.34, 5.5)
    assert (round(paper.saved[0], 2), round(paper.saved[1], 3)) == (3.84, 9.179)  # printed as 9.175, from 9.34 - .165
    assert round(improvement(3.72, 1.82), 2) == 51.08


def test_the_papers_way_makes_the_simulator_like_the_robot_and_the_robot_better(study: PaperStudy) -> None:
    assert study.calibration.losses.min() < 0.6 * study.calibration.losses[0]
    assert study.tuning.losses.min() < 0.9 * study.tuning.losses[0]
    assert study.scores[1] < study.scores[0] < 0.1
    for reading in ("joint", "separate", "accumulated", "mean"):
        before, after = study.tracking(reading)
        assert 0.0 < after < before
    delay = study.calibration.best[BETAS.index("steering_delay")]
    truth = chasi.robot(1).truth
    assert delay == pytest.approx(truth.steering_delay + truth.steering_lag + truth.latency, abs=0.12)


def test_a_drive_tells_what_the_vehicle_is(drive: Recording) -> None:
    truth = chasi.robot(1).truth
    found = calibrate_drives([drive], chasi.simulator())
    value = {e.name: e.value for e in found.estimates}
    assert value["wheel_scale"] == pytest.approx(truth.wheel_scale, abs=0.005)
    assert value["steering_scale"] == pytest.approx(truth.steering_scale, abs=0.02)
    assert value["steering_offset"] == pytest.approx(truth.steering_offset, abs=0.002)
    lag = truth.steering_delay + truth.steering_lag + truth.latency
    assert value["steering_delay"] + value["steering_lag"] == pytest.approx(lag, abs=0.1)
    wider = doubted(found)
    assert (np.diag(wider.covariance) >= np.diag(found.covariance)).all()
    assert np.linalg.eigvalsh(wider.covariance).min() > -1e-12
    assert noise_of([drive]) == pytest.approx((truth.position_noise, truth.heading_noise), rel=0.4)


def test_the_loop_in_rounds_never_makes_the_robot_worse_and_here_halves_its_error() -> None:
    robot, task = chasi.robot(1), chasi.task()
    story = in_rounds(robot, rounds=1, candidates=2, evaluations=60, samples=4)
    gains, score = story.best
    assert tuple(gains) == task.parameters.names, "the shipped plan tunes what the study does"
    before, after = true_errors(robot, "hairpin", np.array([task.parameters.nominal, list(gains.values())]))
    assert after < 0.49 * before
    assert score <= story.first_score


def test_warping_hides_what_only_time_can_tell(drive: Recording, study: PaperStudy) -> None:
    simulator = chasi.simulator(BETAS, 0.0, 0.0)
    rows = profiles(
        chasi.task(gains=("k1", "k2", "k3")), simulator, study.calibration.best, np.ones(3), drive, points=11
    )
    seen = {p.name: p.open_share for p in rows}
    assert seen["speed_delay"][0] > 0.3 > seen["speed_delay"][1]
    assert seen["steering_delay"][0] < 0.3


def test_localisation_noise_is_found_where_it_counts(drive: Recording) -> None:
    truth = chasi.robot(1).truth
    names = ("steering_delay", "position_noise", "heading_noise")
    found = dict(zip(names, calibrate_betas(drive, names, trials=60).best, strict=True))
    assert found["position_noise"] == pytest.approx(truth.position_noise, rel=0.6)
    assert found["heading_noise"] == pytest.approx(truth.heading_noise, rel=0.6)


def test_the_method_of_earlier_plans_is_that_of_the_product() -> None:
    from trueup.studies.stanley import drives

    assert drives.calibrate_under_doubt is calibrate_drives


def test_an_unknown_course_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="course 'hairpins'"):
        chasi.task(("hairpins",))


def test_the_whole_study_ends_with_a_table_and_a_report_of_all_its_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On fewer courses and windows: what drives tell and what gains earn is claimed above and below, on all of them."""
    for name, courses in (("TRAINING", 2), ("HELD_OUT", 2)):
        monkeypatch.setattr(f"trueup.studies.stanley.courses.{name}", courses)
    monkeypatch.setattr("trueup.campaign.drives.windows", lambda r, length: windows(r, length)[:8])
    told: list[tuple[str, int, int, float]] = []
    lines: list[str] = []
    study = run_study(
        tmp_path / "out", lines.append, number=2, calibration_trials=12, tuning_trials=8, evaluations=12, rounds=1,
        told=lambda *progress: told.append(progress),
    )  # fmt: skip
    assert lines[-1] == f"wrote {tmp_path / 'out' / 'report.html'}"
    assert ("calibrate", 12, 12) in {t[:3] for t in told}
    page = (tmp_path / "out" / "report.html").read_text("utf-8").split("<main>")[1]
    assert page.count("<section") == 2, "how it went, and what to do next"
    assert page.index("<p") < page.index("<svg") < page.index("<table"), "a sentence, a picture, a table"
    assert f"{1e3 * study.errors[0]:.0f} mm" in page[: page.index("<svg")]
    for command in ("trueup new", "trueup inspect", "trueup calibrate", "trueup identify"):
        assert command in page[page.index("<table") :]
    for name, picture in (("report", "demo"), ("study", "")):
        checked(tmp_path / "out" / f"{name}.html", tmp_path, picture)  # where there is a browser
    text = (tmp_path / "out" / "study.html").read_text("utf-8")
    for panel in "abcdef":
        assert f"<figcaption>({panel})" in text
    assert "3.72 → 1.82 (51.08 %)" in text
    assert "src=" not in text, "the report asks for nothing"
    assert "nan" not in text.split("<main>")[1].lower().replace("dominan", "")
    shown = Console(width=120, record=True, file=io.StringIO())
    shown.print(study_table(study))
    words = shown.export_text()
    assert f"{1e3 * study.errors[2]:.1f} mm" in words
    assert f"{len(study.rounds.trials)}" in words


def test_drawn_courses_cover_the_speeds_and_radii_that_they_are_drawn_from() -> None:
    for seed in range(5):
        courses = drawn_courses(4, np.random.default_rng(seed))
        speeds = sorted(float(c.speed.max()) for c in courses)
        for k, speed in enumerate(speeds):  # one in each quarter of 0.3 ... 1.0 m/s, less where bends are tight
            assert 0.3 + 0.7 * k / 4 - 0.06 < speed < 0.3 + 0.7 * (k + 1) / 4 + 1e-9
        assert all(np.abs(c.curvature).max() <= 1.0 + 1e-9 and 22.0 < c.length < 36.0 for c in courses)
        assert np.unique([np.abs(c.curvature).max() for c in courses]).size > 1


def test_gains_tuned_on_several_courses_hold_where_those_of_one_fail() -> None:
    found = across_courses(chasi.robot(42, 3), seed=42, evaluations=36, tries=1)
    held = found.held_out
    assert held[-1] < 0.5 * held[0], "the robot is better everywhere"
    assert held[-1] < np.exp(np.log(held[1:-1]).mean())
    assert found.worst[-1] < found.worst[1:-1].mean()


def test_a_late_pose_is_told_from_a_late_steering() -> None:
    robot, task = chasi.robot(3), chasi.task()
    drive = robot.perform(robot_trials(task, task.parameters.nominal, "")[0])[0]
    simulator = chasi.simulator(threads=1)
    found = dict(zip(simulator.parameters.names, calibrate_drives([drive], simulator).values, strict=True))
    truth = robot.truth
    assert found["localisation_latency"] == pytest.approx(truth.latency, abs=0.03)
    late = truth.latency + truth.steering_delay + truth.steering_lag
    assert sum(found[n] for n in ("localisation_latency", "steering_delay", "steering_lag")) == pytest.approx(
        late, abs=0.06
    )
