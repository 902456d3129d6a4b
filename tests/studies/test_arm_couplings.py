# SPDX-License-Identifier: Apache-2.0
"""A coupled wrist is found in a recording of a real arm; a drive without coupling gets none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.effects import Effect
from trueup.identification.estimation.filtering import Lowpass, derivative
from trueup.identification.inertial import from_com
from trueup.identification.kinematic_tree import KinematicTree, from_dh
from trueup.identification.model_file import load_tree
from trueup.identification.rows import Rows
from trueup.studies.arm.couplings import proposed_couplings

Array = NDArray[np.float64]
PAIRS = ((4, 3), (5, 4), (5, 3))


def model_of(tree: KinematicTree) -> DynamicModel:
    kinds = ("rotor", "coulomb", "viscous", "offset")
    return DynamicModel.of(tree, [(j, Effect(kind)) for kind in kinds for j in range(tree.n)])


@pytest.mark.realdata
def test_the_tx40_wrist_is_coupled_one_to_one_as_its_maker_says(real_data: Path) -> None:
    tree, rate, ratios = (
        load_tree(real_data / "tx40/tx40_mdh_modified.urdf"),
        5000.0,
        [32.0, 32.0, 45.0, -48.0, 45.0, 32.0],
    )
    motor, torque = (
        np.loadtxt(real_data / f"tx40/{name}.csv", delimiter=",", skiprows=1) for name in ("pos_read_data", "curr_data")
    )
    known = np.eye(6)
    known[5, 4] = 1.0
    every, passing = 5, Lowpass(rate, 400.0)
    offsets = np.array([0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0])
    q = passing(np.linalg.solve(known, (motor / ratios).T).T + offsets)
    v = derivative(q, rate)
    a, tau, time = derivative(v, rate), passing((torque * ratios) @ known), np.arange(len(q)) / rate
    model = model_of(tree)
    columns = model.base().independent

    def driven(C: Array) -> list[Rows]:
        own = replace(model, drives=C).rows(*(x[::every] for x in (time, q, v, a, tau)))
        return [own.filtered(Lowpass(rate / every, 100.0), 5)]

    C = proposed_couplings(driven, columns, np.arange(60, 66), PAIRS)
    assert C[5, 4] == pytest.approx(1.0, abs=0.25)
    assert abs(C[4, 3]) < 0.2
    assert abs(C[5, 3]) < 0.2


@pytest.mark.parametrize("hidden", [(0.0, 0.0, 0.0), (0.5, -1.0, 0.2)])
def test_hidden_couplings_are_recovered_and_none_is_invented(
    rng: np.random.Generator, hidden: tuple[float, float, float]
) -> None:
    half = np.pi / 2
    tree = from_dh([0.3, 0.7, 0.2, 0, 0, 0], [-half, 0, -half, half, -half, 0], [0.6, 0, 0, 0.6, 0, 0.1])
    model, truth = model_of(tree), np.eye(6)
    for (d, j), value in zip(PAIRS, hidden, strict=True):
        truth[d, j] = value
    bodies = [from_com(m, np.array([0.1, 0.0, 0.1]), 0.02 * m * np.eye(3)) for m in (60.0, 40.0, 20.0, 8.0, 3.0, 1.0)]
    friction = np.array([[20.0, 30.0, 15.0, 2.0, 2.0, 1.0], [5.0, 6.0, 4.0, 0.3, 0.3, 0.1], [0, 0, 0, 0, 0, 0]])
    values = np.concatenate([*bodies, [10.0, 20.0, 8.0, 1.0, 2.0, 1.5], *friction])
    t = np.arange(0.0, 40.0, 0.01)
    w, size, phase = rng.uniform(1, 4, (3, 6)), rng.uniform(0.2, 0.5, (3, 6)), rng.uniform(0, 6, (3, 6))
    angle = t[:, None, None] * w + phase
    q, v = (size * np.sin(angle)).sum(axis=1), (size * w * np.cos(angle)).sum(axis=1)
    a = -(size * w**2 * np.sin(angle)).sum(axis=1)
    torque = replace(model, drives=truth).rows(t, q, v, a).predict(values)
    torque += 0.01 * torque.std(axis=0) * rng.normal(size=torque.shape)
    C = proposed_couplings(
        lambda C: [replace(model, drives=C).rows(t, q, v, a, torque)],
        model.base().independent, np.arange(60, 66), PAIRS,
    )  # fmt: skip
    np.testing.assert_allclose(C, truth, atol=0.05)
