# SPDX-License-Identifier: Apache-2.0
"""Excitations keep their bounds, criteria are what the papers print, and a better one identifies an arm better."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup import load_tree
from trueup.errors import IdentificationError, ModelError, UnknownNameError
from trueup.excitation.cell import Cell
from trueup.excitation.criteria import Criterion
from trueup.excitation.design import Options, design
from trueup.excitation.expectation import _advice, expectations
from trueup.excitation.limits import JointLimits
from trueup.excitation.periodic import Fourier, Sines, at_rest, joint_box
from trueup.excitation.planner import ViaPoints
from trueup.excitation.regions import Region
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.information import log_determinants
from trueup.identification.kinematic_tree import KinematicTree, from_dh

Array = NDArray[np.float64]
PI = np.pi


def arm() -> KinematicTree:
    """Three joints, like the first three of an industrial arm."""
    inertial = np.array(
        [
            [30.0, 1.0, 0.5, 0.2, 1.0, 0.1, 1.2, 0.05, 0.02, 0.9],
            [20.0, 5.0, 0.3, 0.4, 0.6, 0.05, 2.5, 0.1, 0.03, 2.4],
            [8.0, 1.2, 0.2, 0.9, 0.4, 0.02, 0.5, 0.1, 0.05, 0.3],
        ]
    )
    lower, upper, speed = (np.array(x) for x in ([-2.5, -1.0, -2.0], [2.5, 1.5, 2.0], [2.5, 2.5, 3.0]))
    return from_dh(
        [0.2, 0.5, 0.3], [-PI / 2, 0.0, -PI / 2], [0.5, 0.0, 0.1], [0.0, -PI / 2, 0.0], inertial=inertial, lower=lower,
        upper=upper, speed=speed, effort=np.array([200.0, 250.0, 80.0]),
    )  # fmt: skip


@pytest.fixture(scope="module")
def limits() -> JointLimits:
    return JointLimits.of(arm())


@pytest.fixture(scope="module")
def criterion(limits: JointLimits) -> Criterion:
    return Criterion.of(DynamicModel.with_friction(arm()), limits.torque)


def slopes_agree(time: Array, values: Array, slopes: Array) -> bool:
    """Whether `slopes` (S, n) are the derivatives of `values` (S, n), to the error of differences."""
    off = np.abs(np.gradient(values, time, axis=0) - slopes)[1:-1].max()
    return bool(off < 2e-3 * np.abs(slopes).max())


def test_ranges_in_degrees_by_mistake_are_no_turns_that_an_arm_could_make() -> None:
    """They were taken as rad: an arm that reaches 86 degrees was sent to 149, against its stops."""
    right = arm()
    wrong = right.replace(lower=np.degrees(right.lower), upper=np.degrees(right.upper), speed=np.degrees(right.speed))
    limits = JointLimits.of(wrong)
    np.testing.assert_allclose(limits.lower, JointLimits.of(right).lower)
    np.testing.assert_allclose(limits.upper, JointLimits.of(right).upper)
    np.testing.assert_allclose(limits.speed, JointLimits.of(right).speed)
    assert any("taken as degrees" in note for note in limits.notes)
    assert not any("degrees, as" in note for note in JointLimits.of(right).notes)


def test_sums_of_sines_keep_range_speed_and_acceleration_whatever_the_genes(limits: JointLimits) -> None:
    kind = Sines(limits, 4)
    genes = np.random.default_rng(0).uniform(size=(30, kind.size))
    genes[:4] = np.round(genes[:4])  # corners of the box: all amplitudes and rates at their bounds
    motions = kind.motions(genes, 2000)
    assert (motions.q >= limits.lower).all()
    assert (motions.q <= limits.upper).all()
    assert (np.abs(motions.qd) <= limits.speed * (1 + 1e-9)).all()
    assert (np.abs(motions.qdd) <= limits.acceleration * (1 + 1e-9)).all()
    for b in (0, 10, 20):
        assert slopes_agree(motions.time[b], motions.q[b], motions.qd[b])
        assert slopes_agree(motions.time[b], motions.qd[b], motions.qdd[b])


def test_a_sum_of_sines_lasts_one_period_of_its_slowest_term(limits: JointLimits) -> None:
    kind = Sines(limits, 2)
    genes = np.random.default_rng(1).uniform(size=(1, kind.size))
    motion = kind.motions(genes, 4001)
    spectrum = np.abs(np.fft.rfft(motion.q[0, :-1] - motion.q[0].mean(axis=0), axis=0))
    assert motion.duration[0] <= kind.longest + 1e-9
    assert spectrum[1:].max() > 0
    with pytest.raises(ModelError, match="takes longer than 1 s"):
        Sines(limits, 2, longest=1.0)


def test_fourier_series_start_and_end_at_rest_within_all_limits(limits: JointLimits) -> None:
    kind = Fourier(limits, 8.0, 5)
    genes = np.random.default_rng(2).uniform(size=(40, kind.size))
    genes[:5] = np.round(genes[:5])
    motions = kind.motions(genes, 2500)
    for b in range(len(genes)):
        one = motions.single(b, arm().joints)
        assert one.rests
        assert np.abs(one.qdd[[0, -1]]).max() < 1e-9
    assert (motions.q >= limits.lower - 1e-9).all()
    assert (motions.q <= limits.upper + 1e-9).all()
    assert (np.abs(motions.qd) <= limits.speed * 1.01).all()
    assert (np.abs(motions.qdd) <= limits.acceleration * 1.01).all()
    assert np.abs(motions.qdd[5:] / limits.acceleration).max() > 0.5
    assert slopes_agree(motions.time[7], motions.q[7], motions.qd[7])
    assert slopes_agree(motions.time[7], motions.qd[7], motions.qdd[7])


def test_a_start_and_a_stop_make_any_motion_begin_and_end_at_rest(limits: JointLimits) -> None:
    kind = Sines(limits, 3)
    motion = kind.motions(np.random.default_rng(3).uniform(size=(1, kind.size)), 3000).single(0, arm().joints)
    assert not motion.rests
    whole = at_rest(motion, limits)
    assert whole.rests
    assert slopes_agree(whole.time, whole.q, whole.qd)
    assert (np.abs(whole.qdd) <= limits.acceleration * (1 + 1e-9)).all()
    begin = int(np.argmin(np.abs(whole.q - motion.q[0]).sum(axis=1) + np.abs(whole.qd - motion.qd[0]).sum(axis=1)))
    assert np.allclose(whole.q[begin : begin + 3000], motion.q, atol=1e-9)


def test_the_printed_determinant_is_that_of_the_stacked_weighted_regressor(
    criterion: Criterion, limits: JointLimits
) -> None:
    kind = Sines(limits, 3)
    motions = kind.motions(np.random.default_rng(4).uniform(size=(3, kind.size)), 300)
    for b in range(3):
        phi = criterion.model.regressor(motions.q[b], motions.qd[b], motions.qdd[b])[:, :, criterion.independent]
        d = limits.torque / limits.torque.max()  # eq. 6
        H = (d[None, :, None] * phi).reshape(-1, len(criterion.independent))
        wanted = np.linalg.slogdet(H.T @ H)[1] / np.log(10.0)  # eq. 7
        assert abs(criterion.printed(motions)[b] - wanted) < 1e-6


def test_log_determinants_are_those_of_the_matrices_and_none_of_a_singular_one(
    criterion: Criterion, limits: JointLimits
) -> None:
    m = Fourier(limits, 6.0).motions(np.random.default_rng(5).uniform(size=(5, Fourier(limits, 6.0).size)), 300)
    wanted = found = criterion.model.information(m.q, m.qd, m.qdd, criterion.weights, criterion.independent, threads=2)
    assert np.allclose(log_determinants(found), np.linalg.slogdet(wanted)[1])
    singular = wanted.copy()
    singular[0, 0], singular[0, :, 0] = 0.0, 0.0
    assert log_determinants(singular)[0] == -np.inf


def test_criteria_agree_with_their_definitions(criterion: Criterion, limits: JointLimits) -> None:
    kind = Fourier(limits, 6.0)
    motions = kind.motions(np.random.default_rng(6).uniform(size=(4, kind.size)), 200)
    M = criterion.model.information(motions.q, motions.qd, motions.qdd, criterion.weights, criterion.independent) / 200
    scaled = M * criterion.scale[:, None] * criterion.scale
    for name, wanted in (
        ("A", np.log10(np.trace(np.linalg.inv(scaled), axis1=1, axis2=2))),
        ("E", -np.log10(np.linalg.eigvalsh(scaled)[:, 0])),
        ("condition", 0.5 * np.log10(np.linalg.cond(scaled))),
    ):
        assert np.allclose(replace(criterion, kind=name).losses(motions), wanted, rtol=1e-6)
    # D-optimality splits: det M = det of the others x det of friction given the others
    friction = criterion.model.friction[criterion.independent]
    alone = replace(criterion, friction="alone").losses(motions)
    others = -np.linalg.slogdet(M[:, ~friction][:, :, ~friction])[1] / np.log(10.0)
    assert np.allclose(alone + others, criterion.losses(motions), atol=1e-6)


def test_prediction_is_the_mean_standard_deviation_of_the_torque_on_other_motions(
    criterion: Criterion, limits: JointLimits
) -> None:
    kind = Fourier(limits, 6.0)
    some, others = (kind.motions(np.random.default_rng(s).uniform(size=(2, kind.size)), 150) for s in (7, 8))
    found = criterion.for_motions(others).losses(some)
    Y = criterion.model.regressor(*(x.reshape(-1, 3) for x in (others.q, others.qd, others.qdd)))
    Y = Y[:, :, criterion.independent] * criterion.weights[None, :, None]
    for b in range(2):
        q, qd, qdd = (x[b : b + 1] for x in (some.q, some.qd, some.qdd))
        M = criterion.model.information(q, qd, qdd, criterion.weights, criterion.independent)[0] / 150
        variance = np.einsum("snc,cd,snd->", Y, np.linalg.inv(M), Y) / len(Y)
        assert abs(found[b] - 0.5 * np.log10(variance)) < 1e-6


def test_impossible_wishes_are_named(limits: JointLimits) -> None:
    model = DynamicModel.with_friction(arm())
    with pytest.raises(UnknownNameError, match="criterion 'd' is not in"):
        Criterion.of(model, limits.torque, "d")  # type: ignore[arg-type]
    with pytest.raises(IdentificationError, match="above 0 N m"):
        Criterion.of(model, [1.0, 0.0, 2.0])
    unsaid = replace(Criterion.of(model, limits.torque), kind="prediction")
    motions = Fourier(limits).motions(np.random.default_rng(0).uniform(size=(1, Fourier(limits).size)), 50)
    with pytest.raises(IdentificationError, match="use for_motions"):
        unsaid.losses(motions)


def test_the_quick_search_passes_the_genetic_one_at_less_cost(criterion: Criterion, limits: JointLimits) -> None:
    kind = Fourier(limits, 6.0, 3)
    genetic = design(kind, criterion, Options(method="genetic", population=30, generations=20, samples=400))
    quick = design(kind, criterion, Options(samples=400, candidates=3000, starts=60))
    assert quick.loss < genetic.loss
    coarse = max(60, 4 * len(criterion.independent) // 3 + 20)
    assert quick.evaluations * coarse < 1.5 * genetic.evaluations * 400


def test_the_quick_search_ends_with_a_motion_that_is_possible_at_all_samples(
    criterion: Criterion, limits: JointLimits
) -> None:
    # a region at the edge of the reach: what is possible on coarse samples need not be on fine ones
    cell = Cell.of(arm(), Region.of([0.75, 0.1, 0.6], [0.25, 0.5, 0.3], tool=np.array([0.3, 0.0, 0.0])), limits)
    found = design(ViaPoints(cell, 4), criterion, Options(samples=200, candidates=800, starts=80, coarse=40))
    assert np.isfinite(found.loss)
    assert found.trajectory.rests
    assert (np.abs(found.trajectory.qd) <= limits.speed * (1 + 1e-9)).all()


def test_the_joint_box_of_a_region_is_where_the_tool_is_in_it(limits: JointLimits) -> None:
    cell = Cell.of(arm(), Region.of([0.6, 0.1, 0.8], [0.2, 0.2, 0.2], tool=np.array([0.3, 0.0, 0.0])), limits)
    middle, half = joint_box(cell)
    q = middle + np.random.default_rng(0).uniform(-1, 1, (500, 3)) * half
    assert cell.region.holds(cell.chain.poses(q)[1], 0.1).mean() > 0.9
    assert (half < 0.5 * (limits.upper - limits.lower)).all()


def test_a_designed_excitation_identifies_a_noisy_arm_better_than_random_ones(
    criterion: Criterion, limits: JointLimits
) -> None:
    kind, rng = Fourier(limits, 6.0, 4), np.random.default_rng(9)
    designed = design(kind, criterion, Options(samples=300, candidates=2000, starts=60)).genes
    random = rng.uniform(size=(8, kind.size))
    tests = kind.motions(rng.uniform(size=(20, kind.size)), 100)
    model, columns = criterion.model, criterion.independent
    truth = model.base().of(np.concatenate([model.nominal(), np.zeros(model.p - len(model.nominal()))]))
    place = {int(k): i for i, k in enumerate(model.base().independent)}
    truth = truth[[place[int(k)] for k in columns]]
    weight = criterion.weights[None, :, None]
    Y_test = model.regressor(*(x.reshape(-1, 3) for x in (tests.q, tests.qd, tests.qdd)))[:, :, columns] * weight

    def error(genes: Array) -> float:
        m = kind.motions(genes[None], 300)
        Y = (model.regressor(m.q[0], m.qd[0], m.qdd[0])[:, :, columns] * weight).reshape(-1, len(columns))
        errors = []
        for seed in range(10):
            tau = Y @ truth + 0.02 * np.random.default_rng(seed).standard_normal(len(Y))
            errors.append(Y_test @ (np.linalg.lstsq(Y, tau, rcond=None)[0] - truth))
        return float(np.sqrt(np.mean(np.square(errors))))

    assert error(designed) < 0.7 * float(np.median([error(g) for g in random]))


def test_expected_deviations_are_those_of_repeated_estimates(criterion: Criterion, limits: JointLimits) -> None:
    kind = Fourier(limits, 6.0, 4)
    motion = kind.motions(np.random.default_rng(11).uniform(size=(1, kind.size)), 121).single(0, arm().joints)
    # 121 samples in 6 s are white noise at 20 Hz: repeat the estimate with such noise and look at its spread
    density = (0.01 * limits.torque) ** 2 / 20.0
    bare = criterion.model.tree.replace(inertial=np.full((3, 10), np.nan))  # a file that knows nothing beforehand
    criterion = replace(criterion, model=replace(criterion.model, tree=bare))
    expected = {e.leading: e for e in expectations(criterion, motion, limits, density)}
    model, columns, n = criterion.model, criterion.independent, len(limits.torque)
    offsets = np.broadcast_to(np.eye(n), (121, n, n))  # unknown too, as in any fit
    Y = np.concatenate([model.regressor(motion.q, motion.qd, motion.qdd)[:, :, columns], offsets], axis=2)
    Y = (Y / limits.torque[None, :, None]).reshape(-1, len(columns) + n)
    rng = np.random.default_rng(0)
    spread = np.std([np.linalg.lstsq(Y, 0.01 * rng.standard_normal(len(Y)), rcond=None)[0] for _ in range(300)], axis=0)
    for k, deviation in zip(columns.tolist(), spread[: len(columns)], strict=True):
        assert abs(expected[model.names[k]].deviation / deviation - 1.0) < 0.25
    assert any(e.advice for e in expected.values() if e.percent > 5.0)


def test_what_the_file_says_is_expected_to_be_known_as_far_as_a_fit_takes_it_from_there(
    criterion: Criterion, limits: JointLimits
) -> None:
    kind = Fourier(limits, 6.0, 4)
    motion = kind.motions(np.random.default_rng(11).uniform(size=(1, kind.size)), 121).single(0, arm().joints)
    bare = criterion.model.tree.replace(inertial=np.full((3, 10), np.nan))
    without = replace(criterion, model=replace(criterion.model, tree=bare))

    def deviations(of: Criterion, noise: float) -> NDArray[np.float64]:
        found = {e.name: e.deviation for e in expectations(of, motion, limits, (noise * limits.torque) ** 2)}
        return np.array([found[name] for name in sorted(found)])

    quiet, loud = (deviations(criterion, noise) / deviations(without, noise) for noise in (1e-5, 1.0))
    assert np.all(quiet > 0.99), "what the log tells well the file changes"
    assert np.all(loud < 1.0 + 1e-6)
    assert np.median(loud) < 0.5, "what the log does not tell is not taken from the file"


def test_what_hangs_on_an_upright_axis_is_not_to_be_told_by_gravity(tmp_path: Path) -> None:
    link = (
        '<link name="{}"><inertial><origin xyz=".1 0 0"/><mass value="2"/>'
        '<inertia ixx=".01" iyy=".02" izz=".02" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    joint = (
        '<joint name="j{}" type="revolute"><parent link="{}"/><child link="{}"/><origin xyz=".3 0 0"/><axis xyz="{}"/>'
        '<limit lower="-2" upper="2" effort="50" velocity="3"/></joint>'
    )
    for axis, said in (("0 0 1", "gravity does not show it"), ("0 1 0", "so that gravity tells it")):
        links = "".join(link.format(name) for name in "abcdef")
        joints = "".join(joint.format(k, *pair, axis) for k, pair in enumerate(("ab", "bc", "cd", "de", "ef")))
        (tmp_path / "arm.urdf").write_text(f'<robot name="arm">{links}{joints}</robot>')
        model = DynamicModel.of(load_tree(tmp_path / "arm.urdf"), [])
        column = model.names.index("mc2x")
        assert said in _advice(model, column, 1.0, 10.0, 5.0)
