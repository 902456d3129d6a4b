# SPDX-License-Identifier: Apache-2.0
"""The emulated motion planner: straight moves are straight, blends are smooth, limits are kept, branches are held."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.errors import IdentificationError, ModelError
from trueup.excitation.cell import Cell, Settings
from trueup.excitation.chain import Chain
from trueup.excitation.criteria import Criterion
from trueup.excitation.inverse_kinematics import LEAST_GAIN, REACHED, InverseKinematics, settle
from trueup.excitation.limits import JointLimits
from trueup.excitation.mixture import mixed, wide_classes
from trueup.excitation.planner import ViaPoints, joint_moves
from trueup.excitation.profiles import law, ramps
from trueup.excitation.regions import Region
from trueup.excitation.trajectories import Trajectory
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.kinematic_tree import KinematicTree, from_dh

Array = NDArray[np.float64]
PI = np.pi


def arm(joints: int = 6) -> KinematicTree:
    """An anthropomorphic arm with the lengths of a 16 kg industrial robot; a seventh joint turns its upper arm."""
    rows = [  # a, alpha, d, offset
        (0.3, -PI / 2, 0.6, 0.0), (0.7, 0.0, 0.0, -PI / 2), (0.185, -PI / 2, 0.0, 0.0),
        (0.0, PI / 2, 0.624, 0.0), (0.0, -PI / 2, 0.0, 0.0), (0.0, 0.0, 0.135, 0.0),
    ]  # fmt: skip
    if joints == 7:
        rows.insert(2, (0.0, PI / 2, 0.3, 0.0))
    a, alpha, d, offsets = (list(column) for column in zip(*rows, strict=True))
    lower, upper, speed = (np.full(joints, value) for value in (-2.8, 2.8, 2.7))
    return from_dh(a, alpha, d, offsets, lower=lower, upper=upper, speed=speed)


@pytest.fixture(scope="module")
def cell() -> Cell:
    tree = arm()
    region = Region.of([0.95, 0.1, 0.7], [0.3, 0.3, 0.3])
    return Cell.of(tree, region, JointLimits.of(tree))


def test_the_fastest_law_keeps_its_limits_and_touches_one_of_them() -> None:
    for distance in (1e-3, 0.05, 1.0, 20.0):
        for jerk in (40.0, np.inf):
            T = ramps(distance, 1.0, 4.0, jerk)
            t = np.linspace(0.0, sum(T), 20001)
            s, rate, bend = (np.array(x) * distance for x in zip(*(law(x, *T) for x in t), strict=True))
            assert s[0] == 0.0
            assert abs(s[-1] - distance) < 1e-12
            jerks = np.abs(np.diff(bend) / np.diff(t))
            shares = [rate.max() / 1.0, np.abs(bend).max() / 4.0, jerks.max() / jerk if jerk < np.inf else 0.0]
            assert max(shares) < 1.0 + 1e-6
            assert max(shares) > 0.99
            assert np.abs(np.gradient(s, t) - rate)[1:-1].max() < 2e-3 * max(rate.max(), 1e-9)


def test_inverse_kinematics_inverts_the_forward_kinematics(rng: np.random.Generator) -> None:
    for joints in (6, 7):
        tree = arm(joints)
        chain, limits = Chain.of(tree, tool=[0.05, 0.0, 0.1]), JointLimits.of(tree)
        for _ in range(20):
            q = rng.uniform(-2.0, 2.0, joints)
            kinematics = InverseKinematics.at(chain, limits, q)
            if kinematics.gain(q) < 0.05:
                continue
            R, p = chain.poses(q)
            found, ended = kinematics.solve(
                R, p, q + rng.uniform(-0.05, 0.05, joints), q[kinematics.equations.prescribed]
            )
            assert ended == REACHED
            assert np.abs(found - q).max() < 1e-7


def test_the_jacobian_is_the_slope_of_the_pose(rng: np.random.Generator) -> None:
    chain, q, step = Chain.of(arm(7), tool=[0.1, 0.0, 0.2]), rng.uniform(-1, 1, 7), 1e-6
    slope = [(chain.poses(q + d)[1] - chain.poses(q - d)[1]) / (2 * step) for d in step * np.eye(7)]
    assert np.abs(chain.jacobian(q)[:3] - np.array(slope).T).max() < 1e-8


def test_a_posture_out_of_reach_and_a_singular_one_are_told_apart() -> None:
    tree = arm()
    chain, near = Chain.of(tree), np.array([0.1, 0.2, 0.3, 0.4, 0.9, 0.0])
    kinematics = InverseKinematics.at(chain, JointLimits.of(tree), near)
    R, p = chain.poses(near)
    assert kinematics.solve(R, p * 4.0, near)[1] != REACHED
    with pytest.raises(ModelError, match="no posture reaches the middle of the box"):
        Cell.of(tree, Region.of([3.0, 0.0, 0.5], [0.2, 0.2, 0.2]))


def test_a_pose_that_is_no_number_is_not_reached() -> None:
    tree = arm()
    chain, near = Chain.of(tree), np.array([0.1, 0.2, 0.3, 0.4, 0.9, 0.0])
    kinematics = InverseKinematics.at(chain, JointLimits.of(tree), near)
    R, p = chain.poses(near)
    assert settle(chain.arrays, kinematics.equations, R, p, np.zeros(0), LEAST_GAIN, near.copy()) == REACHED
    assert settle(chain.arrays, kinematics.equations, R, np.nan * p, np.zeros(0), LEAST_GAIN, near.copy()) != REACHED


def test_velocities_and_accelerations_are_derivatives_of_the_positions(cell: Cell) -> None:
    motions = ViaPoints(cell, 5).motions(np.random.default_rng(3).uniform(size=(4, 31)), 20001)
    for b in np.flatnonzero(motions.possible):
        t, q, qd, qdd = motions.time[b], motions.q[b], motions.qd[b], motions.qdd[b]
        assert np.abs(np.gradient(q, t, axis=0) - qd)[1:-1].max() < 1e-5 * np.abs(qd).max()
        assert np.abs(np.gradient(qd, t, axis=0) - qdd)[1:-1].max() < 5e-3 * np.abs(qdd).max()


@pytest.mark.parametrize("fly", [0.0, 0.6, 1.0])
def test_moves_are_straight_away_from_the_blends_and_smooth_in_them(cell: Cell, fly: float) -> None:
    settings = Settings(speed=0.3, turn=1.0, fly=fly, zone=0.03)
    positions, turns, own = cell.via_points(np.random.default_rng(8).uniform(0.1, 0.9, (1, 5, 6)))
    motions = cell.straight(positions, turns, own, [settings], 4001)
    assert motions.possible.all()
    _, p = cell.chain.poses(motions.q[0])
    away = np.full(len(p), np.inf)
    for a, b in zip(positions[0], positions[0][1:], strict=False):
        along = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        away = np.minimum(away, np.linalg.norm(p - a - along[:, None] * (b - a), axis=1))
    near = np.min([np.linalg.norm(p - via, axis=1) for via in positions[0]], axis=0) < 0.03
    assert away[~near].max() < 1e-9
    assert away.max() < (1e-9 if fly == 0.0 else 0.03)
    # accelerations jump nowhere: rounded ramps bound the jerk
    assert np.abs(np.diff(motions.qdd[0], axis=0)).max() < 0.1 * np.abs(motions.qdd[0]).max()
    slowest = np.linalg.norm(np.gradient(p, motions.time[0], axis=0), axis=1)[400:-400].min()
    assert (slowest < 1e-3) == (fly == 0.0)


def test_limits_are_kept_densely_and_motions_start_and_end_at_rest(cell: Cell) -> None:
    fast = Settings(speed=4.0, turn=8.0, ramp=0.1)
    motions = ViaPoints(cell, 6, fast).motions(np.random.default_rng(5).uniform(size=(12, 37)), 3000)
    assert motions.possible.sum() >= 6
    for b in np.flatnonzero(motions.possible):
        assert (np.abs(motions.qd[b]) <= cell.limits.speed * (1 + 1e-9)).all()
        assert (np.abs(motions.qdd[b]) <= cell.limits.acceleration * (1 + 1e-9)).all()
        assert motions.single(int(b), cell.chain.tree.joints).rests


def test_via_points_stay_in_the_box_and_the_cone(cell: Cell) -> None:
    positions, turns, _ = cell.via_points(np.random.default_rng(1).uniform(size=(500, 6)))
    assert cell.region.holds(positions).all()
    lean = np.arccos(np.clip(turns[:, :, 2] @ cell.orientation[:, 2], -1.0, 1.0))
    assert lean.max() <= cell.region.cone + 1e-9
    assert lean.max() > 0.9 * cell.region.cone


def test_all_motions_in_a_region_stay_on_one_branch(cell: Cell) -> None:
    motions = ViaPoints(cell, 6).motions(np.random.default_rng(2).uniform(size=(40, 37)), 100)
    assert motions.possible.mean() > 0.5
    spread = np.ptp(motions.q[motions.possible].reshape(-1, 6), axis=0)
    assert (spread < PI).all()


def test_an_override_changes_the_time_and_not_the_path(cell: Cell) -> None:
    way = cell.via_points(np.random.default_rng(4).uniform(0.2, 0.8, (1, 4, 6)))
    full, half = (cell.straight(*way, [Settings(speed=0.5, override=o)], 500) for o in (1.0, 0.5))
    assert np.allclose(half.q, full.q)
    assert np.allclose(half.duration, 2.0 * full.duration)
    assert np.allclose(half.qdd, full.qdd / 4.0)


def test_joint_moves_pass_their_postures_together_and_keep_the_limits(rng: np.random.Generator) -> None:
    limits = JointLimits.of(arm())
    points = rng.uniform(-2.0, 2.0, (3, 5, 6))
    stopping = joint_moves(limits, points, Settings(fly=0.0), 6001)
    for b in range(3):
        for posture in points[b]:
            assert np.abs(stopping.q[b] - posture).max(axis=1).min() < 1e-2
    blended = joint_moves(limits, points, Settings(), 6001)
    assert (blended.duration < stopping.duration).all()
    for motions in (stopping, blended):
        assert (np.abs(motions.qd) <= limits.speed * (1 + 1e-9)).all()
        assert (np.abs(motions.qdd) <= limits.acceleration * (1 + 1e-9)).all()
        assert np.allclose(motions.qd[:, [0, -1]], 0.0)


def test_an_arm_of_seven_joints_moves_all_of_them() -> None:
    tree = arm(7)
    cell = Cell.of(tree, Region.of([0.9, 0.1, 0.8], [0.25, 0.25, 0.25]))
    via = ViaPoints(cell, 5)
    assert via.size == 5 * 7 + 1
    motions = via.motions(np.random.default_rng(0).uniform(size=(20, via.size)), 200)
    assert motions.possible.any()
    assert (np.ptp(motions.q[motions.possible], axis=1) > 0.01).all()


def test_a_region_file_says_what_is_wrong_with_it(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    file.write_text("[box]\nlower = [0.4, -0.3, 0.2]\nupper = [0.8, 0.3, 0.6]\n[orientation]\ncentre = [0, 1, 0, 0]\n")
    region = Region.load(file)
    assert np.allclose(region.centre, [0.6, 0.0, 0.4])
    assert region.orientation is not None
    assert np.allclose(region.orientation, np.diag([1.0, -1.0, -1.0]))
    assert replace(region, cone=0.1).cone == 0.1
    for text, said in (
        ("[bx]\n", "unknown key 'bx'.*did you mean 'box'"), ("link = 'tool'\n", "'box' is missing"),
        ("[box]\ncentre = [0, 0]\nsize = [1, 1, 1]\n", "centre = .* must hold 3 values"), ("box", "not valid TOML"),
        ("[box]\ncentre = [0, 0, 0]\nsize = [1, 1, 0]\n", "size above 0"),
    ):  # fmt: skip
        file.write_text(text)
        with pytest.raises(ModelError, match=said):
            Region.load(file)


def test_the_mix_fills_its_time_with_motions_that_tell_more_than_the_first_ones_drawn() -> None:
    tree = arm().replace(inertial=np.full((6, 10), np.nan))
    known = JointLimits.of(tree)
    limits = replace(known, acceleration=np.full(6, 6.0), torque=np.full(6, 50.0))
    criterion = Criterion.of(DynamicModel.with_friction(tree), limits.torque)
    classes = wide_classes(limits, np.zeros(6), length=4.0, rate=100.0)

    def told(motions: list[Trajectory]) -> float:
        total = sum(
            criterion.model.information(t.q[None], t.qd[None], t.qdd[None], 1.0 / limits.torque, criterion.independent)[
                0
            ]
            for t in motions
        )
        return float(np.linalg.slogdet(total)[1])

    for seed in range(3):
        chosen = mixed(classes, criterion, 25.0, np.random.default_rng(seed))
        rng, first = np.random.default_rng(seed), list[Trajectory]()
        for draw in 6 * list(classes.values()):
            t = draw(rng)
            if t is not None and t.duration <= 25.0 - sum(c.duration for c in first):
                first.append(t)
        assert 18.0 < sum(t.duration for t in chosen) <= 25.0
        assert told(chosen) > told(first)
    with pytest.raises(IdentificationError, match="too short"):
        mixed(classes, criterion, 0.5, np.random.default_rng(0))
