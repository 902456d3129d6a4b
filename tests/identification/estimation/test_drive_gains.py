# SPDX-License-Identifier: Apache-2.0
"""A payload that was weighed sets the scale of currents: hidden drive gains are recovered, and doubt is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.errors import IdentificationError
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.effects import Effect
from trueup.identification.estimation.payload import drive_gains
from trueup.identification.inertial import from_com
from trueup.identification.kinematic_tree import from_dh
from trueup.identification.rows import Rows

Array = NDArray[np.float64]
HALF = np.pi / 2
TREE = from_dh([0.3, 0.7, 0.2, 0], [-HALF, 0, -HALF, HALF], [0.6, 0, 0, 0.6], [0, -HALF, 0, 0])
MODEL = DynamicModel.of(TREE, [(j, Effect(kind)) for kind in ("rotor", "coulomb", "viscous") for j in range(4)])
COLUMNS = MODEL.base().independent
GAINS = np.array([40.0, 55.0, 30.0, 8.0])
PAYLOAD = from_com(12.0, np.array([0.05, 0.1, 0.2]), np.diag([0.2, 0.25, 0.15]))


def truth() -> Array:
    bodies = [from_com(m, np.array([0.1, -0.05, 0.1]), 0.1 * m * np.eye(3)) for m in (60.0, 40.0, 25.0, 8.0)]
    return np.concatenate([*bodies, [5.0, 8.0, 4.0, 1.0], [20.0, 30.0, 15.0, 4.0], [5.0, 6.0, 4.0, 1.0]])


def run(rng: np.random.Generator, payload: Array | None, noise: float = 0.01) -> Rows:
    """40 s of sums of sines, currents with noise of a share of their size."""
    t = np.arange(0.0, 40.0, 0.02)
    w, a, f = rng.uniform(0.5, 3.0, (3, 4)), rng.uniform(0.2, 0.5, (3, 4)), rng.uniform(0, 6, (3, 4))
    angle = t[:, None, None] * w + f
    rows = MODEL.rows(
        t, (a * np.sin(angle)).sum(axis=1), (a * w * np.cos(angle)).sum(axis=1), -(a * w**2 * np.sin(angle)).sum(axis=1)
    )
    parameters = truth()
    if payload is not None:
        parameters[30:40] += payload
    current = rows.predict(parameters) / GAINS
    return replace(rows, torque=current + noise * current.std(axis=0) * rng.normal(size=current.shape))


def test_gains_and_inertia_are_recovered_from_currents(rng: np.random.Generator) -> None:
    found = drive_gains([run(rng, None)], [run(rng, PAYLOAD)], PAYLOAD, COLUMNS)
    np.testing.assert_allclose(found.gains, GAINS, rtol=0.03)
    assert (np.abs(found.gains - GAINS) < 4.0 * found.deviations).all()
    assert not found.poor().size
    rows = run(rng, None, noise=0.0)
    predicted = rows.predict(found.parameters)
    assert np.linalg.norm(predicted - rows.torque * GAINS) < 0.03 * np.linalg.norm(predicted)


@pytest.mark.parametrize(("noise", "known"), [(0.01, 10), (0.05, 10), (0.2, 4), (0.05, 1)])
def test_intervals_of_gains_hold_whatever_the_noise_of_the_currents_and_what_is_known_of_the_payload(
    noise: float, known: int
) -> None:
    given, errors = np.where(np.arange(10) < known, PAYLOAD, np.nan), []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        found = drive_gains([run(rng, None, noise)], [run(rng, PAYLOAD, noise)], given, COLUMNS)
        errors.append((found.gains - GAINS) / found.deviations)
    assert np.mean(np.abs(errors) < 2.13) >= 0.8  # of 24; by chance once in two hundred where 95 % hold
    assert np.abs(np.mean(errors, axis=0)).max() < 2.0  # a noisy regressor gave gains 20 % too small, ten deviations


def test_a_payload_that_hardly_loads_a_drive_is_said_to_leave_its_gain_open(rng: np.random.Generator) -> None:
    known = drive_gains([run(rng, None)], [run(rng, PAYLOAD / 300.0)], PAYLOAD / 300.0, COLUMNS)
    assert np.allclose(known.gains, GAINS, rtol=0.3)  # forty grams on 140 kg tell a little
    light = PAYLOAD / 3000.0  # four grams nothing
    try:
        found = drive_gains([run(rng, None)], [run(rng, light)], light, COLUMNS)
    except IdentificationError as error:
        assert "payload" in str(error)  # noqa: PT017
    else:
        assert found.poor().size


def test_what_cannot_be_is_named(rng: np.random.Generator) -> None:
    free, loaded = run(rng, None), run(rng, PAYLOAD)
    with pytest.raises(IdentificationError, match="one of them is missing"):
        drive_gains([free], [], PAYLOAD, COLUMNS)
    with pytest.raises(IdentificationError, match="mass above 0 kg"):
        drive_gains([free], [loaded], np.zeros(10), COLUMNS)
    wrong = replace(loaded, torque=loaded.torque * [1, -1, 1, 1]), replace(free, torque=free.torque * [1, -1, 1, 1])
    with pytest.raises(IdentificationError, match=r"drive 2 .* other sign"):
        drive_gains([wrong[1]], [wrong[0]], PAYLOAD, COLUMNS)
