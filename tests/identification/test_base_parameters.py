# SPDX-License-Identifier: Apache-2.0
"""Base parameters: the published table of an arm row by row, the known counts of others, torque unchanged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trueup.errors import ModelError
from trueup.identification.base_parameters import base_parameters
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.kinematic_tree import KinematicTree, from_dh
from trueup.identification.model_file import load_tree

# Table II of "On Robot Dynamic Model Identification through Sub-Workspace Evolved Trajectories for Optimal Torque
# Estimation", rows 1-40, for a COMAU SMART NS16. The table prints three digits; its constants are lengths of the arm.
TABLE_II = """mc2y; I2xy; I2yz; I3xy; I3yz; I3m; mc4x; I4xy; I4xz; I4m; mc5x; I5xy; I5xz; I5yz; I5m; mc6x; mc6y; I6xy; I6xz
I6yz; I6zz; I6m; I1yy + I1m + .090 m2 + I2yy + .580 m3 + I3zz + .614 m4 + .614 m5 + .614 m6
mc2x + .700 m3 + .700 m4 + .700 m5 + .700 m6; I2xx - I2yy - .490 m3 - .490 m4 - .490 m5 - .490 m6; I2xz + .700 mc3y
I2zz + I2m + .490 m3 + .490 m4 + .490 m5 + .490 m6; mc3x + .185 m4 + .185 m5 + .185 m6
mc3z + mc4y + .624 m5 + .624 m6; I3xx - I3zz - .034 m4 + I4zz + .355 m5 + .355 m6
I3xz - .185 mc4y - .115 m5 - .115 m6; I3yy + .034 m4 + I4zz + .423 m5 + .423 m6; mc4z - mc5y; I4xx - I4zz + I5zz
I4yy + I5zz; I4yz + .624 mc5y; mc5z + mc6z; I5xx - I5zz + I6yy; I5yy + I6yy; I6xx - I6yy"""


def ns16() -> KinematicTree:
    """The arm with gravity along axis 1, in the axes and about the points that the table turns out to use."""
    half = np.pi / 2
    return from_dh([0.3, 0.7, 0.185, 0, 0, 0], [half, 0, -half, half, -half, 0], [0.6, 0, 0, 0.624, 0, 0.135])


def coefficients(row: str) -> dict[str, float]:
    """'I2xz + .700 mc3y' -> {'I2xz': 1.0, 'mc3y': 0.7}."""
    found, sign, number = {}, 1.0, 1.0
    for word in row.split():
        if word in "+-":
            sign, number = (1.0 if word == "+" else -1.0), 1.0
        elif word[0].isalpha():
            found[word] = sign * number
        else:
            number = float(word)
    return found


def test_ns16_has_the_papers_forty_base_parameters_row_by_row() -> None:
    model = DynamicModel.with_friction(ns16(), friction=())
    base = model.base()
    assert (model.p, base.rank) == (66, 40)
    rows = [row.strip() for line in TABLE_II.splitlines() for row in line.split(";")]
    assert len(rows) == 40
    ours = {model.names[k]: row for k, row in zip(base.independent, base.grouping, strict=True)}
    for printed in map(coefficients, rows):
        mine = ours[next(iter(printed))]
        for name, value in zip(model.names, mine, strict=True):
            # .423 is d4^2 + a3^2 = .4236 cut short; all others are rounded
            assert value == pytest.approx(printed.get(name, 0.0), abs=7e-4), (printed, name)
    assert "I2zz + I2m + 0.490 m3 + 0.490 m4 + 0.490 m5 + 0.490 m6" in base.names
    assert base.unseen == ("m1", "mc1x", "mc1y", "mc1z", "I1xx", "I1xy", "I1xz", "I1yz", "I1zz", "mc2z")


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["tx40/tx40_mdh_modified.urdf", "ur10/ur10_robot.urdf"])
def test_six_joint_arms_have_forty_base_parameters_and_eighteen_of_friction(real_data: Path, name: str) -> None:
    base = DynamicModel.with_friction(load_tree(real_data / name)).base()
    assert base.rank == 58
    assert base.gap > 1e6


def test_a_coupled_wrist_has_as_many_base_parameters_and_its_rotor_stays_apart() -> None:
    drives = np.eye(6)
    drives[5, 4] = 1.0
    alone, coupled = (DynamicModel.with_friction(ns16(), drives=C) for C in (np.eye(6), drives))
    assert coupled.base().rank == alone.base().rank
    assert "I6m" in coupled.base().names


def test_torque_of_full_and_base_parameters_agree(rng: np.random.Generator) -> None:
    model = DynamicModel.with_friction(ns16())
    base = model.base()
    Y = model.regressor(*(rng.normal(size=(50, 6)) * 3 for _ in range(3)))
    values = rng.normal(size=model.p)
    np.testing.assert_allclose(base.reduce(Y) @ base.of(values), Y @ values, atol=1e-11 * np.abs(Y).max())
    moved = base.full(base.of(values), prior=np.zeros(model.p))
    np.testing.assert_allclose(Y @ moved, Y @ values, atol=1e-11 * np.abs(Y).max())
    assert np.linalg.norm(moved) < np.linalg.norm(values)


def test_a_preferred_parameter_stands_for_its_group() -> None:
    model = DynamicModel.with_friction(ns16())
    wish = np.array([name in ("m6", "I4zz") for name in model.names], dtype=float)
    base = model.base(preference=wish)
    assert base.rank == 58
    assert {model.names.index("m6"), model.names.index("I4zz")} <= set(base.independent.tolist())


@pytest.mark.parametrize("error", [4e-6, 1e-4])
def test_right_angles_written_as_157_or_exported_a_hair_off_do_not_change_the_groups(error: float) -> None:
    tree = ns16()
    skewed = np.array([[1, error, 0], [-error, 1, 0], [0, 0, 1.0]])
    rounded = DynamicModel.with_friction(tree.replace(rotation=tree.rotation @ skewed)).base()
    assert rounded.rank == 58
    assert [name.split(" ")[0] for name in rounded.names] == [
        name.split(" ")[0] for name in DynamicModel.with_friction(tree).base().names
    ]


def test_an_unclear_rank_is_an_error_not_a_guess(rng: np.random.Generator) -> None:
    mixed = np.linalg.qr(rng.normal(size=(18, 18)))[0]
    values = np.linalg.qr(rng.normal(size=(50, 18)))[0] @ np.diag(3.0 ** -np.arange(18.0)) @ mixed
    with pytest.raises(ModelError, match="is not clear"):
        base_parameters(values, tuple("abcdefghijklmnopqr"))


def test_all_joints_prismatic_show_only_masses() -> None:
    gantry = from_dh([0, 0, 0], [np.pi / 2, np.pi / 2, 0], [0, 0, 0], prismatic=[True] * 3)
    base = DynamicModel.with_friction(gantry, friction=(), rotors=False).base()
    assert base.rank == 3
    assert all(name.startswith("m") for name in base.names)
