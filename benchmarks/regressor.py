# SPDX-License-Identifier: Apache-2.0
"""The joint-torque regressor of a 6-joint arm beside Pinocchio's, called in a loop: time a sample and core, difference."""

from __future__ import annotations

import argparse
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import time
from collections.abc import Callable

import numpy as np
import pinocchio as pin  # pyright: ignore[reportMissingImports]
from numpy.typing import NDArray
from results import result

from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.kinematic_tree import KinematicTree, from_dh
from trueup.identification.regressors import inverse_dynamics, regressor

Array = NDArray[np.float64]


def arm() -> KinematicTree:
    """A 6-joint arm with offset shoulder and spherical wrist, its links rods of a few kilograms."""
    half = np.pi / 2
    rods = np.array([[m, 0.1 * m, 0, 0.05 * m, 0.02 * m, 0, 0.02 * m, 0, 0, 0.02 * m] for m in (40, 30, 20, 8, 3, 1.0)])
    return from_dh(
        [0.3, 0.7, 0.185, 0, 0, 0], [half, 0, -half, half, -half, 0], [0.6, 0, 0, 0.624, 0, 0.135], inertial=rods
    )


def in_pinocchio(tree: KinematicTree) -> pin.Model:
    """The same arm, built joint by joint."""
    model = pin.Model()
    for j in range(tree.n):
        pose = pin.SE3(tree.rotation[j], tree.offset[j])
        i = model.addJoint(int(tree.parent[j]) + 1, pin.JointModelRevoluteUnaligned(tree.axis[j]), pose, tree.joints[j])
        model.appendBodyToJoint(i, pin.Inertia.FromDynamicParameters(tree.inertial[j]), pin.SE3.Identity())
    return model


def microseconds(work: Callable[[], object], samples: int, repeats: int) -> float:
    """CPU time of the best of some runs, in us a sample: others may use the machine meanwhile."""
    work()
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        work()
        times.append(time.process_time() - begin)
    return min(times) / samples * 1e6


def main() -> None:
    """Prints times of regressor, torque and Gram matrices, and the largest difference to Pinocchio."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer repeats")
    options = parser.parse_args()
    repeats, S, B = (10, 2000, 20) if options.quick else (50, 2000, 100)
    rng, tree = np.random.default_rng(0), arm()
    model = in_pinocchio(tree)
    data = model.createData()
    q, qd, qdd = rng.uniform(-3, 3, (S, 6)), rng.normal(size=(S, 6)) * 2, rng.normal(size=(S, 6)) * 5

    def loop() -> Array:
        return np.array([pin.computeJointTorqueRegressor(model, data, *x).copy() for x in zip(q, qd, qdd, strict=True)])

    def loop_torque() -> Array:
        return np.array([pin.rnea(model, data, *x).copy() for x in zip(q, qd, qdd, strict=True)])

    dynamic = DynamicModel.with_friction(tree)
    base = dynamic.base().independent
    ones = np.ones(tree.n)
    batch = [np.tile(x, (B, 1, 1)) for x in (q, qd, qdd)]
    ours, peer = regressor(tree, q, qd, qdd), loop()
    difference = float(np.abs(ours - peer).max() / np.abs(peer).max())
    times = {
        "regressor": (microseconds(lambda: regressor(tree, q, qd, qdd), S, repeats), microseconds(loop, S, repeats)),
        "torque": (
            microseconds(lambda: inverse_dynamics(tree, tree.inertial, q, qd, qdd), S, repeats),
            microseconds(loop_torque, S, repeats),
        ),
        "Gram matrices": (
            microseconds(
                lambda: dynamic.information(batch[0], batch[1], batch[2], ones, base), B * S, max(3, repeats // 10)
            ),
            float("nan"),
        ),
    }
    print(f"us a sample and core, {S} samples, 6 joints ({len(base)} base and friction columns in the Gram matrices)")
    print(f"{'':15s} {'trueup':>8s} {'pinocchio':>10s}")
    for name, (mine, theirs) in times.items():
        print(f"{name:15s} {mine:8.3f} {theirs:10.3f}")
    print(f"largest difference of an entry over the largest entry: {difference:.1e}")
    mine, theirs = times["regressor"]
    peer = "pinocchio in a loop"
    result("microseconds_per_sample", mine, "us", 0.125, peer=peer, peer_value=theirs, ratio_goal=True)
    result("gram_microseconds_per_sample", times["Gram matrices"][0], "us", 0.15, peer=f"{peer}, regressor alone",
           peer_value=theirs, ratio_goal=True)  # fmt: skip
    result("max_difference_to_pinocchio", difference, "of the largest entry", 1e-12)


if __name__ == "__main__":
    main()
