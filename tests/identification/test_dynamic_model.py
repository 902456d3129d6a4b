# SPDX-License-Identifier: Apache-2.0
"""Friction, rotors, couplings and gears: hidden ones are recovered, names and units say what they are."""

from __future__ import annotations

import numpy as np
import pytest

from trueup.errors import ModelError, ParameterError, UnknownNameError
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.friction import Coupling, Term, stribeck_speed
from trueup.identification.kinematic_tree import from_dh

KINDS = (
    "coulomb", "viscous", "quadratic", "offset", "coulomb_forward", "coulomb_backward", "viscous_forward",
    "viscous_backward", "cubic",
)  # fmt: skip
TERMS = (*map(Term, KINDS), Term("stribeck", 0.1), Term("saturating", 0.2))
WRIST = from_dh([0.2, 0.1, 0.0], [0.3, np.pi / 2, 0.0], [0.1, 0.2, 0.3], prismatic=[False, True, False])


def test_each_term_is_the_same_compiled_and_in_words(rng: np.random.Generator) -> None:
    model = DynamicModel.of(WRIST, friction=TERMS, rest=0.05)
    q, qd, qdd = rng.normal(size=(3, 70, 3)) * 0.3
    Y = model.regressor(q, qd, qdd)
    for k, c in enumerate(model.columns[30:], 30):
        expected = qdd[:, c.joint] if c.term is None else c.term.column(qd[:, c.joint], model.rest)
        np.testing.assert_allclose(Y[:, c.joint, k], expected, atol=1e-14)
        assert not np.delete(Y[:, :, k], c.joint, axis=1).any()


def test_a_coupled_drive_loads_both_joints_as_power_demands(rng: np.random.Generator) -> None:
    ratio = -0.7
    model = DynamicModel.of(WRIST, couplings=[Coupling(drive=2, joint=0, ratio=ratio)])
    q, qd, qdd = rng.normal(size=(3, 40, 3))
    values = np.zeros(model.p)
    values[[model.index("I31m"), model.index("f0_31"), model.index("f1_31")]] = 0.3, 2.0, 0.5
    v, a = qd[:, 2] + ratio * qd[:, 0], qdd[:, 2] + ratio * qdd[:, 0]
    force = 0.3 * a + 2.0 * np.sign(v) + 0.5 * v
    torque = model.regressor(q, qd, qdd) @ values
    np.testing.assert_allclose((torque * qd).sum(axis=1), force * v, atol=1e-12)


def test_hidden_friction_and_inertia_are_recovered(rng: np.random.Generator) -> None:
    model = DynamicModel.of(WRIST)
    base = model.base()
    q, qd, qdd = rng.normal(size=(3, 500, 3)) * 2
    truth = rng.normal(size=model.p)
    Y = model.regressor(q, qd, qdd)
    torque = (Y @ truth).ravel() + rng.normal(size=1500) * 1e-3
    found = np.linalg.lstsq(base.reduce(Y).reshape(1500, -1), torque, rcond=None)[0]
    np.testing.assert_allclose(found, base.of(truth), atol=2e-3)


def test_the_stribeck_speed_is_found_and_its_absence_seen(rng: np.random.Generator) -> None:
    v = rng.normal(size=4000) * 0.5
    plain = np.column_stack([np.sign(v), v, rng.normal(size=4000)])
    torque = plain @ [40.0, 6.0, 3.0] + rng.normal(size=4000)
    found, share = stribeck_speed(v, torque + 15.0 * Term("stribeck", 0.08).column(v), plain)
    assert found == pytest.approx(0.08, rel=0.05)
    assert share > 0.8
    assert stribeck_speed(v, torque, plain)[1] < 0.01


def test_columns_have_names_units_and_an_order() -> None:
    model = DynamicModel.of(WRIST, friction=[("coulomb",), ("coulomb", "viscous"), ()], rotors=[True, False, True])
    assert model.names[30:] == ("I1m", "I3m", "f0_1", "f0_2", "f1_2")
    assert [c.unit for c in model.columns[30:]] == ["kg m^2", "kg m^2", "N m", "N", "N s/m"]


def test_what_cannot_be_is_named() -> None:
    with pytest.raises(UnknownNameError, match=r"friction term 'columb' .*did you mean 'coulomb'"):
        DynamicModel.of(WRIST, friction=["columb"])
    with pytest.raises(ParameterError, match="'stribeck' needs a speed above 0"):
        DynamicModel.of(WRIST, friction=["stribeck"])
    with pytest.raises(ParameterError, match="for 2 joints; there are 3: joint1, joint2, joint3"):
        DynamicModel.of(WRIST, friction=[("coulomb",), ("coulomb",)])
    with pytest.raises(ModelError, match=r"must be \(individuals, samples, 3\)"):
        DynamicModel.of(WRIST).grams(*np.zeros((3, 10, 3)))
