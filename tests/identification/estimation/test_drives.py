# SPDX-License-Identifier: Apache-2.0
"""Gears and couplings keep power; a drives file is read, and what is wrong in it named."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from trueup.errors import IdentificationError, UnknownNameError
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.identify import Options, identify
from trueup.identification.estimation.result import relative_error
from trueup.recording import Channel, Recording

JOINTS = ("a", "b", "c")
GIVEN = {
    "positions": "motor", "torques": "motor",
    "joints": {"a": {"ratio": 30, "offset": 0.1}, "b": {"ratio": -50.0}, "c": {"ratio": 40, "torque_constant": 0.2}},
    "couplings": [{"drive": "c", "joint": "b", "ratio": 1.0}],
}  # fmt: skip


def test_power_is_the_same_on_both_sides_of_the_gears(rng: np.random.Generator) -> None:
    drives = Drives.from_dict({**GIVEN, "joints": {**GIVEN["joints"], "c": {"ratio": 40}}}, JOINTS)
    speed, torque = rng.normal(size=(2, 20, 3))
    joint = np.sum(drives.joint_speeds(speed) * drives.joint_torques(torque), axis=1)
    assert np.allclose(joint, np.sum(speed * torque, axis=1))


def test_a_coupled_motor_turns_with_both_joints() -> None:
    drives = Drives.from_dict(GIVEN, JOINTS)
    q = np.array([[0.3, -0.2, 0.5]])
    motor = np.array([[30.0 * (q[0, 0] - 0.1), -50.0 * q[0, 1], 40.0 * (q[0, 2] + q[0, 1])]])
    assert np.allclose(drives.joint_positions(motor), q)


def test_currents_become_torques_by_the_constants() -> None:
    drives = Drives.from_dict({"joints": {"c": {"torque_constant": 0.2}}}, JOINTS)
    assert np.allclose(drives.joint_torques(np.ones((1, 3))), [[1.0, 1.0, 0.2]])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"gears": 1}, "unknown key 'gears'"),
        ({"positions": "gear"}, "is not one of: motor, joint"),
        ({"joints": {"a": {"ratio": 0}}}, "non-zero"),
        ({"joints": {"a": {"ratio": float("nan")}}}, "joints, a, ratio = nan: must be a finite number"),
        ({"joints": {"a": {"spring": "gas"}}}, "a.*spring = 'gas': is not one of: torsion, strut, none"),
        ({"couplings": [{"drive": "c"}]}, "'joint' is missing"),
        ({"couplings": [{"drive": "c", "joint": "c"}]}, "both 'c'"),
    ],
)
def test_what_is_wrong_in_a_drives_file_is_named(change: dict[str, object], said: str) -> None:
    with pytest.raises(IdentificationError, match=said):
        Drives.from_dict(change, JOINTS)


def test_an_unknown_joint_is_refused_with_the_choices(tmp_path: Path) -> None:
    file = tmp_path / "drives.toml"
    file.write_text("[joints.elbow]\nratio = 3\n")
    with pytest.raises(UnknownNameError, match="joints are: a, b, c"):
        Drives.load(file, JOINTS)


def test_the_drives_file_of_the_manual_can_be_read() -> None:
    page = Path(__file__).resolve().parents[3] / "docs" / "identify.md"
    (example,) = re.findall(r"```toml\n(.*?)```", page.read_text("utf-8"), re.DOTALL)
    drives = Drives.from_dict(tomllib.loads(example), [f"joint_{k}" for k in range(1, 7)])
    assert drives.ratios[0] == 32.0
    assert drives.coupling[5, 4] == 1.0


def test_currents_of_unknown_constants_are_no_torques_and_weigh_no_body(arms: SimpleNamespace) -> None:
    tree, rng = arms.arm(), np.random.default_rng(3)
    run = arms.recording(tree, rng, seconds=12.0)
    torque = run.channel("torque")
    current = Channel("current", torque.labels, "A", torque.time, torque.values / np.array([12.0, 9.0, 5.0, 4.0]))
    log = Recording("run", {"position": run.channel("position"), "current": current})
    found = identify(tree, [log], options=Options(hold_out=0.3))
    assert found.units == ("A",) * 4
    assert found.links == ()
    assert "no mass is in kg" in found.warnings[0]
    assert relative_error(found.held_out()) < 0.03
    known = {"joints": {j: {"torque_constant": c} for j, c in zip(tree.joints, (12.0, 9.0, 5.0, 4.0), strict=True)}}
    weighed = identify(tree, [log], drives=Drives.from_dict(known, tree.joints), options=Options(hold_out=0.3))
    assert weighed.units == ("N m",) * 4
    assert [link.mass for link in weighed.links] == pytest.approx(np.asarray(tree.inertial)[:, 0].tolist(), rel=0.2)
