# SPDX-License-Identifier: Apache-2.0
"""Possible bodies by cross-validation: sound logs pull them from the file, and a drive that no rotor explains is named."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.effects import Effect
from trueup.identification.estimation.blocks import blocks_of, numbered
from trueup.identification.estimation.bodies import cross_validated_fit
from trueup.identification.estimation.consistent import ConsistentFit, violations
from trueup.identification.estimation.moments import moments_of
from trueup.identification.rows import Rows

Array = NDArray[np.float64]


def _found(arms: SimpleNamespace, rotors: Array) -> tuple[DynamicModel, ConsistentFit, Rows]:
    """The fit to noisy torque of an arm with viscous friction and these inertias of drives, starting from a wrong file."""
    tree, rng, time = arms.arm(), np.random.default_rng(0), np.arange(1200) / 40.0
    kinds = ("rotor", "viscous", "lag")
    model = DynamicModel.of(tree, [(d, Effect(kind)) for kind in kinds for d in range(tree.n)])
    truth = np.concatenate([np.asarray(tree.inertial).ravel(), rotors, np.full(tree.n, 3.0), np.zeros(tree.n)])
    rows = model.rows(time, *arms.sines(rng, time, tree.n))
    torque = rows.predict(truth)
    size = np.sqrt(np.mean(torque**2, axis=0))
    noisy = Rows(rows.columns, rows.values, torque + 0.01 * size * rng.normal(size=torque.shape), time, rows.p)
    wrong = truth.copy()
    wrong[: 10 * tree.n] *= np.repeat([1.3, 0.7, 1.2, 0.8], 10)
    wrong[10 * tree.n :] = 0.0
    active = np.concatenate([np.arange(10 * tree.n), model.columns_of("rotor", "viscous")])
    weights = size**-2.0
    moments = moments_of(blocks_of([noisy], numbered([noisy], 8), 0.0))
    found = cross_validated_fit(model, moments, weights / weights.mean(), active, wrong)
    clean = Rows(rows.columns, rows.values, torque, time, rows.p)
    return model, found.fit, clean


def test_bodies_leave_a_wrong_file_as_far_as_sound_logs_ask_for(arms: SimpleNamespace) -> None:
    model, fit, clean = _found(arms, arms.rotors)
    error = clean.torque - clean.predict(fit.parameters)
    assert fit.lagging == ()
    assert not fit.parameters[model.columns_of("lag")].any()
    assert np.all(np.std(error, axis=0) < 0.004 * np.std(clean.torque, axis=0))


@pytest.mark.parametrize("drive", [2, 3])
def test_torque_that_falls_with_acceleration_is_told_from_rotors_and_bodies_stay_possible(
    arms: SimpleNamespace, drive: int
) -> None:
    rotors = arms.rotors.copy()
    rotors[drive] = -0.5
    model, fit, clean = _found(arms, rotors)
    assert fit.lagging == (drive,)
    assert violations(model, fit.parameters) == {}
    assert fit.parameters[model.columns_of("rotor")].min() >= -1e-8
    assert fit.parameters[model.columns_of("lag")][drive] < -0.2
    error = clean.torque - clean.predict(fit.parameters)
    assert np.all(np.std(error, axis=0) < 0.006 * np.std(clean.torque, axis=0))
