# SPDX-License-Identifier: Apache-2.0
"""Regressor, torque and Gram matrices against Pinocchio and MuJoCo, which know nothing of this code."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.errors import ModelError
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.inertial import from_com
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.model_file import load_tree
from trueup.identification.poses import link_poses
from trueup.identification.regressors import inverse_dynamics, regressor

pin = pytest.importorskip("pinocchio", reason="the reference; pip install 'trueup[bench]'")
Array = NDArray[np.float64]


def random_tree(rng: np.random.Generator, n: int, *, branched: bool = True) -> KinematicTree:
    """N joints with oblique axes, every third prismatic, some on branches, of random bodies."""
    axes = rng.normal(size=(n, 3))
    parent = [-1, *(int(rng.integers(-1 if branched else j - 1, j)) if branched else j - 1 for j in range(1, n))]
    bodies = [
        from_com(rng.uniform(0.5, 5), rng.normal(size=3) / 5, np.diag(rng.uniform(0.1, 0.2, 3))) for _ in range(n)
    ]
    nan = np.full(n, np.nan)
    return KinematicTree(
        name="random", joints=tuple(f"j{i}" for i in range(n)), links=tuple(f"l{i}" for i in range(n)),
        parent=np.array(parent), prismatic=np.arange(n) % 3 == 2, axis=axes / np.linalg.norm(axes, axis=1)[:, None],
        rotation=np.array([pin.SE3.Random().rotation for _ in range(n)]), offset=rng.normal(size=(n, 3)),
        gravity=rng.normal(size=3) * 5, lower=nan, upper=nan, speed=nan, effort=nan, inertial=np.array(bodies),
        armature=np.zeros(n),
    )  # fmt: skip


def in_pinocchio(tree: KinematicTree) -> Any:
    model = pin.Model()
    model.gravity.linear = tree.gravity
    for j in range(tree.n):
        kind = pin.JointModelPrismaticUnaligned if tree.prismatic[j] else pin.JointModelRevoluteUnaligned
        pose = pin.SE3(tree.rotation[j], tree.offset[j])
        i = model.addJoint(int(tree.parent[j]) + 1, kind(tree.axis[j]), pose, tree.joints[j])
        model.appendBodyToJoint(i, pin.Inertia.FromDynamicParameters(tree.inertial[j]), pin.SE3.Identity())
    return model


def motion(rng: np.random.Generator, *shape: int) -> tuple[Array, Array, Array]:
    return rng.uniform(-7, 7, shape), rng.normal(size=shape) * 2, rng.normal(size=shape) * 5


@pytest.mark.parametrize(("n", "branched"), [(1, False), (6, False), (9, True)])
def test_regressor_and_torque_equal_pinocchio_for_any_tree(rng: np.random.Generator, n: int, branched: bool) -> None:
    tree = random_tree(rng, n, branched=branched)
    model = in_pinocchio(tree)
    data = model.createData()
    q, qd, qdd = motion(rng, 75, n)  # not a multiple of any block
    rows = np.array([pin.computeJointTorqueRegressor(model, data, *x).copy() for x in zip(q, qd, qdd, strict=True)])
    torque = np.array([pin.rnea(model, data, *x) for x in zip(q, qd, qdd, strict=True)])
    scale = np.abs(rows).max()
    np.testing.assert_allclose(regressor(tree, q, qd, qdd), rows.reshape(75, n, -1), atol=1e-13 * scale)
    np.testing.assert_allclose(
        inverse_dynamics(tree, tree.inertial, q, qd, qdd), torque, atol=1e-12 * np.abs(torque).max()
    )


def test_link_poses_equal_pinocchio(rng: np.random.Generator) -> None:
    tree = random_tree(rng, 7)
    model = in_pinocchio(tree)
    data = model.createData()
    q = motion(rng, 5, 7)[0]
    R, p = link_poses(tree, q)
    for s in range(5):
        pin.forwardKinematics(model, data, q[s])
        np.testing.assert_allclose(R[s], [data.oMi[i + 1].rotation for i in range(7)], atol=1e-12)
        np.testing.assert_allclose(p[s], [data.oMi[i + 1].translation for i in range(7)], atol=1e-12)


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["panda/panda.urdf", "tx40/tx40_mdh_modified.urdf", "ur10/ur10_robot.urdf"])
def test_urdf_is_read_as_pinocchio_reads_it(real_data: Path, rng: np.random.Generator, name: str) -> None:
    tree = load_tree(real_data / name)
    model = pin.buildModelFromUrdf(str(real_data / name))
    assert list(model.names)[1:] == list(tree.joints)
    np.testing.assert_allclose([k.toDynamicParameters() for k in list(model.inertias)[1:]], tree.inertial, atol=1e-13)
    q, qd, qdd = motion(rng, 10, tree.n)
    if model.nq == tree.n:
        data = model.createData()
        reference = [pin.rnea(model, data, *x) for x in zip(q, qd, qdd, strict=True)]
        np.testing.assert_allclose(
            inverse_dynamics(tree, tree.weighed(), q, qd, qdd), reference, rtol=1e-11, atol=1e-11
        )


def test_mjcf_torque_equals_mujoco(tmp_path: Path, rng: np.random.Generator) -> None:
    import mujoco

    file = tmp_path / "arm.xml"
    file.write_text(
        """<mujoco><option gravity="1 2 -9"/><compiler angle="radian"/><worldbody>
        <body pos=".1 .2 .3" euler=".3 .2 .1"><joint name="a" axis="1 1 0" pos=".1 0 .2" ref=".4"/>
          <joint name="b" type="slide" axis="0 1 1" ref=".1"/><geom type="capsule" size=".05 .2" pos="0 .1 .2"/>
          <body pos="0 .3 .1"><geom type="box" size=".1 .2 .05"/>
            <body pos=".2 0 .1" quat="1 2 3 4"><joint name="c" axis="0 1 0"/><geom type="sphere" size=".1" pos=".1 .1 0"/>
        </body></body></body></worldbody></mujoco>"""
    )
    tree = load_tree(file)
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    q, qd, qdd = (x / 5 for x in motion(rng, 20, 3))
    torque = []
    for data.qpos[:], data.qvel[:], data.qacc[:] in zip(q, qd, qdd, strict=True):
        mujoco.mj_inverse(model, data)
        torque.append(data.qfrc_inverse.copy())
    assert tree.joints == ("a", "b", "c")
    np.testing.assert_allclose(inverse_dynamics(tree, tree.weighed(), q, qd, qdd), torque, atol=1e-10)


def test_locking_joints_leaves_the_others_torque_as_it_was(rng: np.random.Generator) -> None:
    tree = random_tree(rng, 9)
    q, qd, qdd = motion(rng, 8, 9)
    held, moving = [1, 4, 5], [0, 2, 3, 6, 7, 8]
    q[:, held], qd[:, held], qdd[:, held] = (0.3, -0.4, 0.5), 0.0, 0.0
    locked = tree.lock([f"j{i}" for i in held], (0.3, -0.4, 0.5))
    whole = inverse_dynamics(tree, tree.inertial, q, qd, qdd)[:, moving]
    np.testing.assert_allclose(
        inverse_dynamics(locked, locked.inertial, q[:, moving], qd[:, moving], qdd[:, moving]), whole, atol=1e-10
    )


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("samples", [7, 256, 333])
def test_information_is_that_of_the_dense_regressor(rng: np.random.Generator, threads: int, samples: int) -> None:
    model = DynamicModel.with_friction(random_tree(rng, 6))
    q, qd, qdd = motion(rng, 4, samples, 6)
    columns, weights = model.base().independent, rng.uniform(0.5, 2.0, 6)
    found = model.information(q, qd, qdd, weights, columns, threads=threads)
    for b in range(4):
        Y = (model.regressor(q[b], qd[b], qdd[b])[..., columns] * weights[None, :, None]).reshape(-1, len(columns))
        np.testing.assert_allclose(found[b], Y.T @ Y, atol=1e-12 * np.abs(Y.T @ Y).max())


def test_power_is_the_rate_of_energy(rng: np.random.Generator) -> None:
    """A law of physics: without friction, torque times speed is the change of kinetic and potential energy."""
    tree = random_tree(rng, 6)
    t, h = 0.3, 1e-5
    a, w, c = rng.normal(size=6), rng.uniform(1, 3, 6), rng.normal(size=6)

    def energy(at: float) -> float:
        q, v = c + a * np.sin(w * at), a * w * np.cos(w * at)
        still = tree.replace(gravity=np.zeros(3))
        kinetic = 0.5 * v @ inverse_dynamics(still, tree.inertial, q, np.zeros(6), v)[0]
        R, p = link_poses(tree, q)
        moments = tree.inertial[:, :1] * p[0] + np.einsum("nij,nj->ni", R[0], tree.inertial[:, 1:4])
        return float(kinetic - (moments @ tree.gravity).sum())

    q, v, acc = c + a * np.sin(w * t), a * w * np.cos(w * t), -a * w**2 * np.sin(w * t)
    power = v @ inverse_dynamics(tree, tree.inertial, q, v, acc)[0]
    assert power == pytest.approx((energy(t + h) - energy(t - h)) / (2 * h), rel=1e-7)


def test_samples_of_the_wrong_shape_are_refused_with_the_joints_named() -> None:
    tree = random_tree(np.random.default_rng(0), 3)
    with pytest.raises(ModelError, match=r"must be \(samples, 3\) for joints j0, j1, j2; got .*\(5, 4\)"):
        regressor(tree, np.zeros((5, 3)), np.zeros((5, 4)), np.zeros((5, 3)))
