# SPDX-License-Identifier: Apache-2.0
"""Friction, rotors, couplings and gears: hidden ones are recovered, names and units say what they are."""

from __future__ import annotations

import numpy as np
import pytest

from trueup.errors import ModelError, ParameterError, UnknownNameError
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.effects import Effect
from trueup.identification.kinematic_tree import from_dh

KINDS = ("coulomb", "viscous", "quadratic", "offset", "root", "asymmetric", "spring")
FRICTION = (*map(Effect, KINDS), Effect("saturating", 0.2))
WRIST = from_dh([0.2, 0.1, 0.0], [0.3, np.pi / 2, 0.0], [0.1, 0.2, 0.3], prismatic=[False, True, False])


def test_each_effect_is_the_law_of_its_name(rng: np.random.Generator) -> None:
    model = DynamicModel.with_friction(WRIST, friction=FRICTION, rest=0.05)
    q, v, a = rng.normal(size=(3, 70, 3)) * 0.3
    sign = np.clip(v / 0.05, -1.0, 1.0)
    laws = {
        "rotor": a, "coulomb": sign, "viscous": v, "quadratic": sign * v**2, "offset": np.ones_like(v),
        "root": sign * np.sqrt(np.abs(v)), "asymmetric": np.abs(v), "spring": q,
        "saturating": np.tanh(v / 0.2),
    }  # fmt: skip
    Y = model.regressor(q, v, a)
    for k, (drive, effect) in enumerate(model.effects, 30):
        np.testing.assert_allclose(Y[:, drive, k], laws[effect.kind][:, drive], atol=1e-14)
        assert not np.delete(Y[:, :, k], drive, axis=1).any()


def test_a_log_has_the_same_columns_as_the_state(rng: np.random.Generator) -> None:
    drives = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-0.7, 0.4, 1.0]])
    model = DynamicModel.with_friction(WRIST, friction=FRICTION, drives=drives)
    q, v, a = rng.normal(size=(3, 70, 3)) * 0.3
    np.testing.assert_allclose(model.rows(np.arange(70.0), q, v, a).dense(), model.regressor(q, v, a), atol=1e-13)


def test_a_coupled_drive_loads_both_joints_as_power_demands(rng: np.random.Generator) -> None:
    drives = np.eye(3)
    drives[2, 0] = -0.7
    model = DynamicModel.with_friction(WRIST, drives=drives)
    q, qd, qdd = rng.normal(size=(3, 40, 3))
    values = np.zeros(model.p)
    values[[model.names.index(name) for name in ("I3m", "f0_3", "f1_3")]] = 0.3, 2.0, 0.5
    v, a = (x @ drives[2] for x in (qd, qdd))
    force = 0.3 * a + 2.0 * np.sign(v) + 0.5 * v
    torque = model.regressor(q, qd, qdd) @ values
    np.testing.assert_allclose((torque * qd).sum(axis=1), force * v, atol=1e-12)


def test_hidden_friction_and_inertia_are_recovered(rng: np.random.Generator) -> None:
    model = DynamicModel.with_friction(WRIST)
    base = model.base()
    q, qd, qdd = rng.normal(size=(3, 500, 3)) * 2
    truth = rng.normal(size=model.p)
    Y = model.regressor(q, qd, qdd)
    torque = (Y @ truth).ravel() + rng.normal(size=1500) * 1e-3
    found = np.linalg.lstsq(base.reduce(Y).reshape(1500, -1), torque, rcond=None)[0]
    np.testing.assert_allclose(found, base.of(truth), atol=2e-3)


def test_columns_have_names_units_and_an_order() -> None:
    model = DynamicModel.with_friction(
        WRIST, friction=[("coulomb",), ("coulomb", "viscous"), ()], rotors=[True, False, True]
    )
    assert model.names[30:] == ("I1m", "I3m", "f0_1", "f0_2", "f1_2")
    assert list(model.units[30:]) == ["kg m^2", "kg m^2", "N m", "N", "N s/m"]


def test_what_cannot_be_is_named() -> None:
    with pytest.raises(UnknownNameError, match=r"effect 'columb' .*did you mean 'coulomb'"):
        DynamicModel.with_friction(WRIST, friction=["columb"])
    with pytest.raises(ParameterError, match="'saturating' needs a scale above 0"):
        DynamicModel.with_friction(WRIST, friction=["saturating"])
    with pytest.raises(ParameterError, match="for 2 joints; there are 3: joint1, joint2, joint3"):
        DynamicModel.with_friction(WRIST, friction=[("coulomb",), ("coulomb",)])
    with pytest.raises(ModelError, match=r"must be \(individuals, samples, 3\)"):
        DynamicModel.with_friction(WRIST).information(*[np.zeros((10, 3))] * 3, weights=np.ones(3))
