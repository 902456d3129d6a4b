# SPDX-License-Identifier: Apache-2.0
"""`trueup inspect`: a mapping that the next command reads as it is, with what the model and gravity tell of units."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from trueup import prepare, read
from trueup.cli import main
from trueup.formats import ChannelMap

_GANTRY = """<mujoco><compiler angle="degree"/><worldbody><body><joint name="axis" type="slide" axis="1 0 0" range="-.6 .6"/>
<geom size=".05"/><body><joint name="arm" axis="0 1 0" range="-110 110"/><joint name="wrist" axis="1 0 0" range="-90 90"/>
<geom type="capsule" fromto="0 0 0 0 0 .3" size=".02"/><site name="imu"/></body></body></worldbody>
<actuator><position joint="axis" kp="900"/><position joint="arm" kp="50"/><position joint="wrist" kp="50"/></actuator>
<sensor><accelerometer name="acc" site="imu"/><gyro name="gyro" site="imu"/></sensor></mujoco>"""


@pytest.fixture
def logged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a gantry and its log in mm and degrees, of which no column says the unit; the wrist stands still."""
    monkeypatch.chdir(tmp_path)
    time, rng = np.arange(0.0, 6.0, 0.01), np.random.default_rng(0)
    axis, arm, still = 300.0 * np.sin(2.0 * time), 70.0 * np.sin(3.0 * time), np.zeros(len(time))
    tilt, turn = np.radians(arm), np.radians(210.0) * np.cos(3.0 * time)
    acc = np.stack([9.81 * np.sin(-tilt), still, 9.81 * np.cos(tilt)], axis=1) + 0.05 * rng.standard_normal(
        (len(time), 3)
    )
    gyro = np.stack([still, turn, still], axis=1) + 0.01 * rng.standard_normal((len(time), 3))
    seen = np.stack([axis, arm], axis=1) + 0.1 * rng.standard_normal((len(time), 2))
    columns = [time, axis, arm, still, *seen.T, still, *acc.T, *gyro.T]
    names = "t,axis.set,arm.set,wrist.set,axis.actual,arm.actual,wrist.actual," + ",".join(
        f"imu/{kind}.{x}" for kind in ("linear_acceleration", "angular_velocity") for x in "xyz"
    )
    np.savetxt("log.csv", np.stack(columns, axis=1), delimiter=",", header=names, comments="", fmt="%.5f")
    Path("gantry.xml").write_text(_GANTRY)
    return tmp_path


def test_units_that_the_model_and_gravity_tell_are_in_the_mapping(
    logged: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["inspect", "log.csv", "--model", "gantry.xml"]) == 0
    said = capsys.readouterr().out + capsys.readouterr().err
    channels = ChannelMap.load(logged / "mapping.toml").channels
    assert channels["position"].units == channels["command"].units == ("mm", "deg", "deg"), "zeros are in degrees, too"
    assert channels["imu_linear_acceleration"].unit == "m/s^2"
    assert channels["imu_angular_velocity"].unit == "rad/s"
    assert not re.search("unit unknown|is suspected|say unit", said)


def test_units_are_told_by_ranges_of_joints_that_the_log_calls_otherwise(
    logged: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (logged / "log.csv").read_text()
    (logged / "log.csv").write_text(
        text.replace("axis.", "a1_x.").replace("arm.", "a2_lift.").replace("wrist.", "a3_hand.")
    )
    assert main(["inspect", "log.csv", "--model", "gantry.xml"]) == 0
    guess = ChannelMap.load(logged / "mapping.toml")
    assert guess.joints == {"a1_x": "axis", "a2_lift": "arm", "a3_hand": "wrist"}
    assert guess.channels["position"].units == ("mm", "deg", "deg")
    assert guess.channels["position"].labels == ("a1_x", "a2_lift", "a3_hand"), "labels stay those of the file"
    assert "unit unknown" not in capsys.readouterr().out


def test_a_mapping_with_the_models_labels_and_no_units_is_read(logged: Path) -> None:
    assert main(["inspect", "log.csv", "--model", "gantry.xml", "--json"]) == 0
    text = re.sub(r'unit = "(rad/s|m/s\^2)"', 'unit = ""', (logged / "mapping.toml").read_text())
    (logged / "mapping.toml").write_text(text)
    runs = read(["log.csv"], "mapping.toml")
    assert runs[0].channel("imu_angular_velocity").labels[0] == "gyro.x"
    ready = prepare("gantry.xml", runs)
    assert any('say unit = "rad/s" of it' in note for note in ready.notes), "of a gyro by its labels, too"


def test_the_only_joint_of_a_model_is_no_other_one_under_a_mapping_that_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bench.xml").write_text("""<mujoco><worldbody><body><joint name="horn" axis="0 1 0"/><geom size=".1"/></body>
</worldbody><actuator><position joint="horn" kp="9"/></actuator></mujoco>""")
    time = np.arange(0.0, 3.0, 0.02)
    rows = np.stack([time, np.sin(time), np.sin(time)], axis=1)
    np.savetxt("log.csv", rows, delimiter=",", header="t,goal_position,position", comments="")
    assert main(["inspect", "log.csv"]) == main(["inspect", "log.csv", "--model", "bench.xml"]) == 0
    assert "[horn]" in (said := capsys.readouterr().out)
    assert "has no joint" not in said


def test_channels_that_the_mapping_says_are_shares_lack_no_unit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    time = np.arange(0.0, 3.0, 0.02)
    rows = np.stack([time, np.sin(time), 500.0 * np.sin(time)], axis=1)
    np.savetxt("log.csv", rows, delimiter=",", header="t,q_cart,u_cart", comments="")
    told = '[time]\ncolumn = "t"\n[channels.position]\ncolumns = ["q_cart"]\nlabels = ["cart"]\nunit = "m"\n'
    push = '[channels.command_torque]\ncolumns = ["u_cart"]\nlabels = ["cart"]\nunit = "{}"\n'
    for unit, said in (("permille", "1 x share"), ("", "unit unknown: say it in the mapping")):
        Path("mapping.toml").write_text(told + push.format(unit))
        assert main(["inspect", "log.csv"]) == 0
        assert said in capsys.readouterr().out


def test_what_never_changes_is_asked_for_no_unit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    time = np.arange(0.0, 3.0, 0.02)
    rows = np.stack([time, np.sin(time), np.zeros_like(time)], axis=1)
    np.savetxt("log.csv", rows, delimiter=",", header="t,q_cart,height_z", comments="")
    assert main(["inspect", "log.csv"]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "height" in line]
    assert "0 all along" in line
    assert "unknown" not in line
