# SPDX-License-Identifier: Apache-2.0
"""Parameters files: what is written is read back as the same parameters, and what is wrong in one is named."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from trueup.articulated.declaration_file import read_declarations, write_parameters
from trueup.articulated.declarations import Declaration, declare
from trueup.calibration import Calibration, Estimate
from trueup.engines.mujoco.model import Model, load
from trueup.errors import OutputError, ParameterError, UnknownNameError

MODEL = """<mujoco>
  <worldbody>
    <body name="left_leg">
      <joint name="left_hip" damping="0.1"/><inertial pos="0 .1 0" mass="1" diaginertia="1 1 1"/>
    </body>
    <body name="right_leg"><joint name="right_hip"/><inertial pos="0 -.1 0" mass="1" diaginertia="1 1 1"/></body>
  </worldbody>
  <actuator><position name="a" joint="left_hip" kp="5"/><position name="b" joint="right_hip" kp="5"/></actuator>
</mujoco>"""
LINES = (
    Declaration("kp"), Declaration("friction", tie="mirror"), Declaration("com_y", tie="mirror", lower=-0.3, upper=0.3),
    Declaration("delay", tie="all", name="delay"), Declaration("delay", ("a",), name="extra", frozen=True, nominal=0.0),
    Declaration("damping", ("left_*",), optional="drag"), Declaration("tilt_roll"), Declaration("kv", ("a+b",)),
)  # fmt: skip


@pytest.fixture
def model(tmp_path: Path) -> Model:
    (tmp_path / "legs.xml").write_text(MODEL)
    return load(tmp_path / "legs.xml")


def outcome(model: Model) -> Calibration:
    space, _ = declare(model, LINES)
    moved = [p.nominal + 0.3 * (p.upper - p.nominal) * (not p.frozen) for p in space.parameters]
    estimates = tuple(
        Estimate(p.name, p.unit, p.nominal, v, np.nan, np.nan, p.lower, p.upper, not p.frozen, "weak", 'a "note"')
        for p, v in zip(space.parameters, moved, strict=True)
    )
    return Calibration("legs", estimates, (), (), np.zeros((0, 0)))


def test_what_is_written_is_read_back_as_the_same_parameters(model: Model, tmp_path: Path) -> None:
    calibration = outcome(model)
    space, quantities = declare(model, LINES)
    write_parameters(calibration, space, quantities, tmp_path / "p.toml")
    again, same = declare(model, read_declarations(tmp_path / "p.toml"))
    assert again.names == space.names
    assert again.nominal == pytest.approx(calibration.values, rel=1e-15)
    assert same == quantities
    for one, other in zip(again.parameters, space.parameters, strict=True):
        kept = ("lower", "upper", "scale", "frozen", "unit", "optional")
        assert [getattr(one, k) for k in kept] == [getattr(other, k) for k in kept]


def test_a_value_beyond_its_bound_by_a_last_bit_is_read_back_at_the_bound(model: Model, tmp_path: Path) -> None:
    space, quantities = declare(model, LINES)
    below = [p.lower - 1e-12 * abs(p.lower) for p in space.parameters]
    estimates = tuple(
        Estimate(p.name, p.unit, v, v, np.nan, np.nan, p.lower, p.upper, not p.frozen, "weak")
        for p, v in zip(space.parameters, below, strict=True)
    )
    found = Calibration("legs", estimates, (), (), np.zeros((0, 0)))
    write_parameters(found, space, quantities, tmp_path / "p.toml")
    again, _ = declare(model, read_declarations(tmp_path / "p.toml"))
    assert again.nominal.tolist() == [p.lower for p in space.parameters]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[[parameter]]\nquantity = 'frictoin'", "quantity 'frictoin' is not in .*did you mean 'friction'"),
        ("[[parameter]]\nquantity = 'kp'\nbound = 3", "1: unknown key 'bound' = 3; keys are: .*of, optional, quantity"),
        ("[[parameter]]\nof = 'a'", "1: 'quantity' is missing"),
        ("[[parameter]]\nquantity = 'kp'\nnominal = 'x'", "nominal = 'x': must be a number"),
        ("[[parameter]]\nquantity = 'kp'\nnominal = inf", "nominal = inf is not a finite number"),
        ("[[parameter]]\nquantity = 'kp'\nof = 3", "of = 3: must be text in quotes or a list"),
        ("[[parameter]]\nquantity = 'kp'\nfrozen = 1", "frozen = 1: must be true or false"),
        ("[[parameter]]\nquantity = 'bias'\nunit = 'deg'", "unit 'deg' is given, but bias is in 'rad'"),
        ("[parameters]\nkp = 3", r"unknown key 'parameters'.*did you mean 'parameter'"),
        ("", "no .*parameter.* is declared"),
        ("[[parameter", "not valid TOML"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "p.toml").write_text(text)
    with pytest.raises((ParameterError, UnknownNameError), match=said):
        read_declarations(tmp_path / "p.toml")


def test_a_full_disk_leaves_the_old_file(model: Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calibration = outcome(model)
    (tmp_path / "p.toml").write_text("old")

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match="No space left"):
        write_parameters(calibration, *declare(model, LINES), tmp_path / "p.toml")
    assert (tmp_path / "p.toml").read_text() == "old"


def test_slides_have_units_of_force_and_bounds_that_their_drives_could_hold(tmp_path: Path) -> None:
    (tmp_path / "m.xml").write_text(
        """<mujoco><worldbody><body><joint name="x" type="slide"/><geom size=".1" mass="8"/>
        <body><joint name="c"/><geom size=".05" mass="1"/></body></body>
        <body><joint name="belt" type="slide"/><geom size=".1" mass="2"/></body></worldbody>
        <actuator><position joint="x" name="X" kp="4000"/><position joint="c" name="C" kp="5"/>
        <velocity joint="belt" kv="60"/></actuator></mujoco>"""
    )
    lines = [Declaration("kp", ("X", "C")), Declaration("friction"), Declaration("armature")]
    space, _ = declare(load(tmp_path / "m.xml"), lines)
    units = {p.name: p.unit for p in space.parameters}
    assert (units["X.kp"], units["x.friction"], units["x.armature"]) == ("N/m", "N", "kg")
    assert (units["C.kp"], units["c.friction"], units["c.armature"]) == ("N m/rad", "N m", "kg m2")
    upper = {p.name: p.upper for p in space.parameters}
    assert upper["x.friction"] == pytest.approx(80.0)
    assert upper["x.armature"] == pytest.approx(180.0)
    assert upper["c.friction"] == pytest.approx(2.5)
    assert upper["belt.friction"] == pytest.approx(38.0, rel=0.02)  # a servo of speed holds, too
