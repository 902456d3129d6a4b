# SPDX-License-Identifier: Apache-2.0
"""Every quantity keeps its contract on MuJoCo and on an engine of plain numbers, others' quantities too."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from mujoco.batch import Batch
from numpy.typing import NDArray

from trueup.articulated.assignments import write
from trueup.articulated.declaration_file import read_declarations, write_parameters
from trueup.articulated.declarations import Declaration, declare
from trueup.articulated.described import StoredCopies
from trueup.articulated.quantities.drives import DRIVES
from trueup.articulated.quantities.known import quantities, quantity
from trueup.articulated.quantities.quantity import Quantity, between
from trueup.articulated.simulator import ArticulatedSimulator
from trueup.calibration import Calibration, Estimate
from trueup.ends import Left
from trueup.engines.mujoco.attributes import MujocoCopies
from trueup.engines.mujoco.model import Model, load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.errors import ParameterError, UnknownNameError
from trueup.loop.fit import Fit
from trueup.loop.identifiability import verdicts
from trueup.recording import Channel, Recording
from trueup.testing import check_attributes, check_quantity, check_simulator
from trueup.testing.broken import ContractBrokenError
from trueup.trial import Trial

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples" / "cart_pole"))
import cart_pole  # type: ignore[import-not-found]

Array = NDArray[np.float64]

ARM = """
<mujoco model="arm">
  <option timestep="0.002" integrator="implicitfast"/>
  <default><joint damping="0.2" frictionloss="0.05" armature="0.01"/><position kp="20" kv="0.5" forcerange="-2 2"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 0.1"/>
    <body name="turret" pos="0 0 0.12"><joint name="yaw" axis="0 0 1"/>
      <inertial pos="0.01 0.02 0" mass="0.3" diaginertia="4e-4 5e-4 6e-4"/>
      <body name="upper"><joint name="shoulder" axis="0 1 0"/>
        <inertial pos="0.1 0.01 0.02" mass="0.3" fullinertia="1e-3 2e-3 2.2e-3 1e-4 2e-4 1e-4"/>
        <geom name="tip" type="sphere" size="0.03" pos="0.2 0 0" mass="0"/>
        <geom name="painted" type="box" size="0.05 0.05 0.01" mass="0" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator><position name="yaw" joint="yaw"/><position name="shoulder" joint="shoulder"/></actuator>
</mujoco>
"""
JOINTS = ("yaw", "shoulder")
NAMES = {"recording": ("dip",), "channel": ("position",)}
WITHOUT_EFFECT = ("stribeck_speed", "spring_rest", "stop_lower", "stop_upper")
"""Alone they say how fast nothing fades, or where a spring without stiffness rests; a joint without a range has its stops
half a turn away (see test_stops.py)."""


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Model:
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(ARM)
    return load(path)


def dip() -> Recording:
    """Steps and waves that press the tip on the floor and drag it along."""
    time = np.arange(100) / 100.0
    command = np.stack([0.8 * np.sin(6.0 * time), np.where(time % 0.5 < 0.25, 0.3, 0.6)], axis=1)
    channels = {n: Channel(n, JOINTS, "rad", time, command * (n == "command")) for n in ("command", "position")}
    return Recording("dip", channels)


def simulator(model: Model, lines: Sequence[Declaration]) -> MujocoSimulator:
    return MujocoSimulator(model, *declare(model, lines, NAMES), threads=1)


@pytest.mark.parametrize("name", quantities())
def test_a_quantity_keeps_its_contract_in_mujoco(arm: Model, name: str) -> None:
    check_quantity(
        quantity(name), arm, dip(), lambda lines: simulator(arm, lines), effect=name not in WITHOUT_EFFECT, extra=NAMES
    )


def test_friction_of_all_contacts_is_of_the_shapes_that_can_touch(arm: Model) -> None:
    made = simulator(arm, [Declaration("contact_friction")])
    assert made.parameters.names == ("floor.contact_friction", "tip.contact_friction")
    assert not made.rollout([Trial.of(dip(), ("position",))], made.parameters.nominal[None])[0].failures
    with pytest.raises(UnknownNameError, match=r"'painted' is not in the shapes of 'arm' that can touch.*floor, tip"):
        simulator(arm, [Declaration("contact_friction", ("painted",))])


def test_a_lower_bound_that_is_as_good_as_none_is_no_wish_to_go_beyond_it(arm: Model) -> None:
    lines = [Declaration("delay", tie="all"), Declaration("bias", ("yaw",), nominal=0.0, lower=0.0)]
    space, _ = declare(arm, lines, NAMES)
    assert [p.vanishes for p in space.parameters] == [True, False]
    fit = Fit(space, np.zeros(2), np.zeros(2), 100.0 * np.eye(2), np.ones(2), "")
    none, beyond = verdicts(fit, 1e-6 * np.eye(2))
    assert (none.word, none.note) == ("at bound", "none is seen (delay at its lower bound)")
    assert "wants to go beyond its lower bound" in beyond.note


def test_mujoco_offers_every_attribute_and_reads_what_was_written(arm: Model) -> None:
    names = ("backlash", "gear_backlash", "gear_compliance", "force_limit", "floor_height", "stop_lower", "stop_upper")
    lines = [Declaration(n) for n in names]
    prepared = simulator(arm, lines).at_step(5e-4).compiled  # a gear is as stiff as the step resolves
    batch = Batch(prepared, 3, 1)
    offered = check_attributes(arm, MujocoCopies(prepared, batch), 3)
    assert {a for q in quantities().values() for a in q.attributes} <= {*offered}


def test_an_engine_of_plain_numbers_keeps_the_contracts() -> None:
    model = cart_pole.CartPole()
    check_attributes(model, model.copies(2), 2)
    time = np.arange(60) / 50.0
    recording = Recording("push", {
        "command": Channel("command", ("motor",), "N", time, 3.0 * np.sin(5.0 * time)[:, None]),
        "position": Channel("position", ("cart", "pole"), "rad", time, np.zeros((60, 2))),
    })  # fmt: skip

    def made(lines: Sequence[Declaration]) -> ArticulatedSimulator:
        return ArticulatedSimulator(model, *declare(model, lines), step=0.01)

    for one in (cart_pole.LENGTH, *(quantity(n) for n in ("mass", "damping", "gain", "delay", "bias"))):
        check_quantity(one, model, recording, made)
    check_quantity(quantity("friction"), model, recording, made, of=("cart",))
    lines = [Declaration(cart_pole.LENGTH), Declaration("delay"), Declaration("friction_static", ("cart",))]
    check_simulator(made(lines), recording)


class WithTip(cart_pole.CartPole):
    """A cart-pole whose tip is watched by a camera."""

    def channels(self) -> dict[str, tuple[str, ...]]:
        return {"camera": ("tip_x", "tip_z")}

    def copies(self, rows: int) -> StoredCopies:
        return Watched(self, rows)


class Watched(StoredCopies):
    def reader(self, state: str, joints: Sequence[str]) -> Callable[[int], Array]:
        if state != "camera":
            return super().reader(state, joints)
        length = self.get("pole.length", "pole")
        columns = [("tip_x", "tip_z").index(label) for label in joints]

        def read(n: int) -> Array:
            (x, angle), size = self.position[:n].T, length[:n]
            return np.stack([x + size * np.sin(angle), -size * np.cos(angle)], axis=1)[:, columns]

        return read


def test_an_engine_s_own_sensors_are_simulated_observed_and_end_runs() -> None:
    model, time = WithTip(), np.arange(60) / 50.0
    recording = Recording("push", {
        "command": Channel("command", ("motor",), "N", time, 3.0 * np.sin(5.0 * time)[:, None]),
        "position": Channel("position", ("cart", "pole"), "rad", time, np.zeros((60, 2))),
        "camera": Channel("camera", ("tip_z", "tip_x"), "m", time, np.zeros((60, 2))),
    })  # fmt: skip
    made = ArticulatedSimulator(model, *declare(model, [Declaration(cart_pole.LENGTH)]), step=0.01)
    check_simulator(made, recording)
    trial = replace(Trial.of(recording), ends=(Left("camera", {"tip_x": (-0.05, 0.05)}),))
    (run,) = made.rollout([trial], np.array([[0.5]]))
    angle, (height, along) = run.channels["position"][0, :, 1], run.channels["camera"][0].T
    lasted = np.isfinite(height)
    assert height[lasted] == pytest.approx(-0.5 * np.cos(angle[lasted]), abs=1e-3)
    assert run.ends[0].name == "left the area"
    assert 0.04 < np.abs(along[lasted]).max() < 0.07


def test_the_quantity_of_the_page_keeps_its_contract(arm: Model) -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "calibrate.md").read_text("utf-8")
    names: dict[str, Quantity] = {}
    exec(next(code for code in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "STIFFENING" in code), names)
    check_quantity(names["STIFFENING"], arm, dip(), lambda lines: simulator(arm, lines))


def test_a_quantity_that_does_nothing_is_caught(arm: Model) -> None:
    idle = Quantity(name="idle", family="joint", unit="rad", title="nothing", bounds=between(0.0, 1.0))
    with pytest.raises(ContractBrokenError, match="'idle' at yaw changes nothing in 'dip'"):
        check_quantity(idle, arm, dip(), lambda lines: simulator(arm, lines))


def test_gain_and_zero_are_applied_to_the_stiffness_that_was_written_whatever_the_order(arm: Model) -> None:
    values = {"kp": 30.0, "gain": 0.5, "zero": 0.1}
    forces = []
    for order in (("kp", "gain", "zero"), ("zero", "gain", "kp")):
        made = simulator(arm, [Declaration(n, ("yaw",), nominal=values[n]) for n in order])
        copies = MujocoCopies(made.compiled, Batch(made.compiled, 1, 1))
        write(made.quantities, made.parameters.nominal[None], copies)
        forces.append([copies.fields.expand(f)[0, 0, :3] for f in ("actuator_gainprm", "actuator_biasprm")])
    assert np.array_equal(forces[0], forces[1])
    assert forces[0][0][0] == pytest.approx(15.0)
    assert forces[0][1][:2] == pytest.approx([1.5, -15.0])


OWN = """
from trueup.articulated.quantities.quantity import Quantity, around
SAG = Quantity(name="sag", family="joint", unit="rad", title="how far a joint sags", bounds=around(0.1), signals=("sensor",))
NUMBER = 3
"""


def test_a_quantity_beside_a_parameters_file_is_read_and_written_back(arm: Model, tmp_path: Path) -> None:
    (tmp_path / "own_quantity.py").write_text(OWN)
    (tmp_path / "p.toml").write_text('[[parameter]]\nquantity = "own_quantity:SAG"\nof = "*"\nnominal = 0.02\n')
    space, assignments = declare(arm, read_declarations(tmp_path / "p.toml"))
    assert space.names == ("yaw.sag", "shoulder.sag")
    estimates = [
        Estimate(p.name, p.unit, p.nominal, 0.03, 0.0, 0.0, p.lower, p.upper, True, "identified")
        for p in space.parameters
    ]
    calibration = Calibration("arm", tuple(estimates), (), (), np.zeros((0, 0)))
    write_parameters(calibration, space, assignments, tmp_path / "found.toml")
    again, same = declare(arm, read_declarations(tmp_path / "found.toml"))
    assert again.nominal == pytest.approx([0.03, 0.03])
    assert same == assignments


def test_an_installed_package_may_register_a_quantity_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "own_quantity.py").write_text(OWN)
    monkeypatch.syspath_prepend(str(tmp_path))
    entry = EntryPoint("sag", "own_quantity:SAG", "trueup.quantities")
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: [entry] if group == entry.group else [])
    assert quantity("sag").title == "how far a joint sags"
    with pytest.raises(UnknownNameError, match=r"quantity 'sagg' is not in .*did you mean 'sag'"):
        quantity("sagg")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("own_quantity:NUMBER", "is a int, not a trueup.Quantity"),
        ("own_quantity:SAGG", "has no 'SAGG'"),
        ("gone:X", "no module 'gone'"),
    ],
)
def test_an_address_that_leads_to_no_quantity_is_refused(tmp_path: Path, name: str, said: str) -> None:
    (tmp_path / "own_quantity.py").write_text(OWN)
    (tmp_path / "p.toml").write_text(f'[[parameter]]\nquantity = "{name}"\n')
    with pytest.raises(ParameterError, match=said):
        read_declarations(tmp_path / "p.toml")


def test_an_attribute_that_an_engine_does_not_offer_is_named() -> None:
    with pytest.raises(UnknownNameError, match=r"attribute 'joint.armature'.*'cart-pole' offers of 'cart'"):
        declare(cart_pole.CartPole(), [Declaration("armature")])
    assert {q.family for q in DRIVES} == {"actuator"}
