# SPDX-License-Identifier: Apache-2.0
"""The stand-in arm hides what it should, and what is hidden can be found: truth, couplings, the papers' base parameters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.errors import OutputError
from trueup.excitation.cell import Cell as RobotCell
from trueup.excitation.cell import Settings
from trueup.excitation.criteria import Criterion
from trueup.excitation.design import Options
from trueup.excitation.periodic import Sines, at_rest
from trueup.excitation.planner import joint_moves
from trueup.excitation.trajectories import Trajectory
from trueup.studies.arm.algorithms import algorithm_a, algorithm_a_local, algorithm_b, random_planner_motion
from trueup.studies.arm.comparison import ALGORITHMS, CASES, Errors, Example, Scale, interval, share_of_best
from trueup.studies.arm.excitation import filled
from trueup.studies.arm.factors import Cell, main_effect, ratios
from trueup.studies.arm.fitting import joined, our_fit, papers_fit
from trueup.studies.arm.hidden import RATE, Effects, HiddenArm
from trueup.studies.arm.measuring import Run, papers_columns, runs, torque_model
from trueup.studies.arm.robot import COULOMB, JOINTS, NOMINAL, QUADRATIC, REGIONS, ROTORS, VISCOUS, limits, ns16
from trueup.studies.arm.saved import Store

Array = NDArray[np.float64]
MODEL = torque_model()
COLUMNS = papers_columns(MODEL)
TRUTH = np.concatenate([ns16().weighed().ravel(), ROTORS, COULOMB, VISCOUS, QUADRATIC, np.zeros(MODEL.p - 84)])


def motions(count: int, seed: int = 0) -> list[Trajectory]:
    """Random sums of sines, 10 s at most each."""
    kind, rng = Sines(limits(), longest=10.0), np.random.default_rng(seed)
    found = []
    for genes in rng.uniform(size=(count, 1, kind.size)):
        samples = int(np.ceil(float(kind.motions(genes, 2).duration[0]) * RATE)) + 1
        found.append(at_rest(kind.motions(genes, samples).single(0, JOINTS, "sines"), limits(), RATE))
    return found


@pytest.fixture(scope="module")
def training() -> list[Run]:
    return runs(MODEL, motions(5))


@pytest.fixture(scope="module")
def others() -> list[Run]:
    return runs(MODEL, motions(2, seed=9))


def test_without_hidden_effects_the_papers_58_parameters_explain_the_arm(
    training: list[Run], others: list[Run]
) -> None:
    assert len(COLUMNS) == 58
    rng, arm = np.random.default_rng(0), HiddenArm(ns16(), Effects.none())
    fit = papers_fit(MODEL, [one.torque(arm, rng, 0.5) for one in training], COLUMNS)
    for one in others:
        rows = one.torque(arm, rng, -0.5)
        assert (np.abs(rows.torque - fit.predict(one, rows)).mean(axis=0) < 0.005 * NOMINAL).all()
        # the truth itself errs by what noise leaves behind a filter of 30 Hz, and by little more
        assert (np.abs(rows.torque - rows.predict(TRUTH)).mean(axis=0) < 0.005 * NOMINAL).all()


@pytest.mark.parametrize("effect", ["stribeck", "load", "temperature", "asymmetric", "coupling", "ripple", "elastic"])
def test_each_effect_changes_torque_and_is_gone_without_it(effect: str) -> None:
    t = motions(1, seed=3)[0]
    bare, full = Effects.none(noise=0.0), Effects(noise=0.0)

    def torque(effects: Effects) -> Array:
        return HiddenArm(ns16(), effects).torque(t.q, t.qd, t.qdd, warmth=0.7)

    alone = torque(Effects.none(noise=0.0, **{effect: 1.0}))
    assert np.abs(alone - torque(bare)).max() > 1e-3 * NOMINAL.min()
    assert np.abs(torque(full.without(effect)) - torque(full)).max() > 1e-3 * NOMINAL.min()
    assert np.abs(alone - torque(bare)).max() < NOMINAL.max()


def test_a_joint_that_bends_rings_after_an_abrupt_stop_and_not_before() -> None:
    points = np.zeros((2, 6))
    points[1, 0] = 0.5
    made = joint_moves(limits(), points, samples=2000)
    rest = np.zeros((500, 6))
    q = np.concatenate([made.q[0], rest + points[1]])
    qd, qdd = (np.concatenate([x[0], rest]) for x in (made.qd, made.qdd))
    stiff, bending = (HiddenArm(ns16(), Effects.none(elastic=e)).torque(q, qd, qdd) for e in (0.0, 1.0))
    ringing = np.abs(bending - stiff)[:, 0]
    assert ringing[0] < 1e-6 * NOMINAL[0]
    assert ringing[2000:2100].max() > 1e-4 * NOMINAL[0]
    assert ringing[-100:].max() < 0.1 * ringing[2000:2100].max()


def test_our_fit_predicts_other_motions_better_and_finds_the_coupled_wrist(
    training: list[Run], others: list[Run]
) -> None:
    rng, arm = np.random.default_rng(2), HiddenArm(ns16(), Effects())
    rows = [one.torque(arm, rng, 0.0) for one in training]
    papers, ours = papers_fit(MODEL, rows, COLUMNS), our_fit(training, arm, rng, 0.0)
    errors = []
    for fit in (papers, ours):
        wrong = [(one, one.torque(arm, np.random.default_rng(5), 0.0)) for one in others]
        errors.append(np.mean([np.abs(r.torque - fit.predict(one, r)).mean(axis=0) for one, r in wrong], axis=0))
    assert (errors[1][3:] < 0.5 * errors[0][3:]).all()  # the wrist, where drives are coupled
    assert (errors[1] < 0.02 * NOMINAL).all()
    np.testing.assert_allclose(ours.model.drives[[4, 5, 5], [3, 4, 3]], (0.3, 0.8, 0.1), atol=0.06)


def test_a_short_motion_that_is_repeated_is_one_recording_and_others_are_their_own(training: list[Run]) -> None:
    some = training[0].trajectory
    there = some.q[:25]
    path = np.concatenate([there, there[::-1]])
    short = Trajectory("short", some.joints, some.time[:50], path, 0.0 * path, 0.0 * path)
    elsewhere = Trajectory("elsewhere", some.joints, some.time[:50], path + 0.1, 0.0 * path, 0.0 * path)
    whole, other = joined([short, short, short, elsewhere])
    assert len(whole.time) == 3 * 50 - 2
    assert np.array_equal(whole.q[49:99], path)
    assert np.allclose(np.diff(whole.time), some.time[1] - some.time[0])
    assert np.array_equal(other.q, elsewhere.q)


def test_recording_times_are_equal() -> None:
    found = motions(2)
    for plan in (filled(13.0, lambda i: found[0]), filled(13.0, lambda i: found[i % 2])):
        assert sum(t.duration for t in plan) == pytest.approx(13.0, abs=0.6)


def test_intervals_hold_the_mean_and_ours_is_credited_only_where_it_is_not_surely_worse() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(3.0, 1.0, (8, 30, 6))
    low, high = interval(values, rng)
    assert ((low < 3.2) & (high > 2.8)).all()
    absolute = {(a, c): rng.normal(3.0, 0.1, (8, 30, 6)) for a in ALGORITHMS for c in CASES}
    absolute |= {("ours", c): absolute["A", c] + np.array([-1.0, -1.0, -1.0, 0.0, 1.0, 1.0]) for c in CASES}
    share, words = share_of_best(Errors(absolute, {}, {}, {}), rng)
    assert 3 / 6 - 1e-9 <= share <= 4 / 6 + 1e-9
    assert all(row[:3] == ["best"] * 3 and set(row[4:]).isdisjoint({"best", "even"}) for row in words.values())


def test_friction_of_another_form_has_no_coefficients_among_the_columns(training: list[Run]) -> None:
    errors = []
    for effects in (Effects.none(noise=0.0), Effects.none(noise=0.0, foreign=1.0)):
        rows = [one.torque(HiddenArm(ns16(), effects), np.random.default_rng(0), 0.0) for one in training]
        fit = our_fit(training, HiddenArm(ns16(), effects), np.random.default_rng(0), 0.0)
        wrong = [np.abs(r.torque - fit.predict(one, r)).mean(axis=0) for one, r in zip(training, rows, strict=True)]
        errors.append(np.mean(wrong, axis=0) / NOMINAL)
    assert (errors[1] > 2.0 * errors[0]).all()
    assert (errors[1] < 0.03).all()


def _made(rng: np.random.Generator, b_local: float) -> Errors:
    """Errors of about one, those of B in its region `b_local` of that."""
    absolute = {(a, c): rng.uniform(0.9, 1.1, (8, 30, 6)) for a in ALGORITHMS for c in CASES}
    absolute |= {(a, c): b_local * absolute[a, c] for a, c in absolute if a.startswith("B") and c.startswith("1")}
    return Errors(absolute, absolute, {c: np.full(30, 100) for c in CASES}, {a: np.zeros(8) for a in ALGORITHMS})


def test_a_hidden_effect_that_helps_local_motion_shows_as_a_factor() -> None:
    rng = np.random.default_rng(0)
    found = ratios({"B": {"with": _made(rng, 0.5), "without": _made(rng, 1.0)}}, seed=0)
    claim = "B over A in its region"
    with_it, without = (found[Cell("B", e, "fast", "gentle"), claim] for e in ("with", "without"))
    assert with_it.value == pytest.approx(0.5, rel=0.05)
    assert (with_it.below, with_it.above) == (6, 0)
    assert without.value == pytest.approx(1.0, rel=0.05)
    assert main_effect(found, claim, "effects", "with", "without").startswith(("x 1.9", "x 2.0"))


def test_a_study_goes_on_from_what_is_there_and_never_over_another(tmp_path: Path) -> None:
    scale, made = Scale(), _made(np.random.default_rng(1), 1.0)
    example = Example(np.arange(3.0), np.ones((3, 6)), {"A": np.zeros((3, 6))})
    made = Errors(made.absolute, made.squared, made.samples, made.indefinite, example)
    store = Store.at(tmp_path / "out", scale)
    store.errors("B all effects", lambda: made)

    def never() -> Errors:
        raise AssertionError

    again = Store.at(tmp_path / "out", scale).errors("B all effects", never)
    np.testing.assert_array_equal(again.absolute["ours", "2 wide sines"], made.absolute["ours", "2 wide sines"])
    assert again.example is not None
    np.testing.assert_array_equal(again.example.measured, example.measured)
    with pytest.raises(OutputError, match="another size or seed"):
        Store.at(tmp_path / "out", Scale(seed=1))
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("")
    with pytest.raises(OutputError, match="something else"):
        Store.at(tmp_path / "mine", scale)


def test_friction_that_does_not_jump_at_standstill_costs_our_fit_nothing_where_nothing_else_is_hidden(
    training: list[Run], others: list[Run]
) -> None:
    rng, arm = np.random.default_rng(4), HiddenArm(ns16(), Effects.none())
    rows = [one.torque(arm, rng, 0.0) for one in training]
    papers, ours = papers_fit(MODEL, rows, COLUMNS), our_fit(training, arm, np.random.default_rng(4), 0.0)
    wrong = [(one, one.torque(arm, rng, 0.0)) for one in others]
    errors = [
        np.mean([np.abs(r.torque - fit.predict(one, r)).mean(axis=0) for one, r in wrong], axis=0) / NOMINAL
        for fit in (papers, ours)
    ]
    assert errors[1].mean() < 0.99 * errors[0].mean()
    assert (errors[1] < 1.02 * errors[0]).all()


@pytest.fixture(scope="module")
def cell() -> RobotCell:
    return RobotCell.of(ns16(), REGIONS["B"], limits())


def test_a_genetic_search_improves_in_each_of_the_papers_algorithms(cell: RobotCell) -> None:
    criterion = Criterion.of(MODEL, NOMINAL, "D", weighting="printed")
    options = Options(method="genetic", population=20, generations=4, samples=120)
    found = [
        algorithm_a(criterion, limits(), options, 100.0), algorithm_a_local(criterion, cell, options, 100.0),
        algorithm_b(criterion, cell, options, via_points=4, rate=100.0),
    ]  # fmt: skip
    for one in found:
        assert one.trace[-1].loss <= one.trace[0].loss
        assert one.trajectory.rests
    inside = cell.chain.poses(found[2].trajectory.q)[1]
    assert cell.region.holds(inside, 1e-6).all()


def test_random_motions_are_within_the_region_or_all_over_the_range(cell: RobotCell) -> None:
    rng = np.random.default_rng(0)
    local = random_planner_motion(cell.limits, rng, region=cell, settings=Settings(fly=0.0))
    assert cell.region.holds(cell.chain.poses(local.q)[1], 1e-6).all()
    wide = random_planner_motion(cell.limits, rng)
    assert np.ptp(wide.q, axis=0).max() > 2.0
    gentle, abrupt = (
        random_planner_motion(
            cell.limits, np.random.default_rng(7), region=cell, speed=(0.3, 0.3), settings=Settings(ramp=r)
        )
        for r in (0.5, 0.1)
    )
    assert np.abs(abrupt.qdd).max() > 2.0 * np.abs(gentle.qdd).max()
