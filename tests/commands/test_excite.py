# SPDX-License-Identifier: Apache-2.0
"""`trueup excite` writes a motion that the arm can perform, says what it will tell, and what is wrong with a wish."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest

from trueup.cli import main
from trueup.formats import read

ARM = """
<mujoco><compiler angle="radian"/><worldbody><geom type="plane" size="5 5 1"/>
  <body name="upper" pos="0 0 0.5">
    <joint name="turn" axis="0 0 1" range="-3 3" actuatorfrcrange="-80 80"/>
    <geom type="capsule" size="0.05" fromto="0 0 0 0 0 0.3" mass="6"/>
    <body name="middle" pos="0 0 0.3">
      <joint name="lift" axis="0 1 0" range="-2.5 2.5" actuatorfrcrange="-90 90"/>
      <geom type="capsule" size="0.04" fromto="0 0 0 0.4 0 0" mass="4"/>
      <body name="lower" pos="0.4 0 0">
        <joint name="bend" axis="0 1 0" range="-2.8 2.8" actuatorfrcrange="-40 40"/>
        <geom type="capsule" size="0.03" fromto="0 0 0 0.35 0 0" mass="2"/>
      </body></body></body>
</worldbody></mujoco>
"""
REGION = "tool = [0.35, 0, 0]\n[box]\ncentre = [0.45, 0.1, 0.6]\nsize = [0.2, 0.3, 0.2]\n"


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    (tmp_path / "arm.xml").write_text(ARM)
    return tmp_path / "arm.xml"


def test_a_motion_comes_out_with_all_its_files(arm: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = arm.parent / "out"
    assert main(["excite", str(arm), "--out", str(out), "--duration", "8", "--budget", "1", "-q"]) == 0
    said = capsys.readouterr().out
    assert "8.0 s trajectory" in said
    assert "clear of collision by" in said
    assert "combinations better than 5 %" in said
    (recording,) = read(out / "trajectory.csv")
    speed = recording.channel("velocity").values
    assert np.allclose(speed[[0, -1]], 0.0, atol=1e-6)
    assert np.abs(speed).max() <= np.pi
    assert ElementTree.parse(out / "path.svg").getroot().tag.endswith("svg")
    assert json.loads((out / "trajectory.json").read_text())["clearance"] >= 0.02
    assert (
        main(["excite", str(arm), "--out", str(out), "--duration", "4", "--motion", "fourier", "--budget", "0.1", "-q"])
        == 0
    )
    assert (arm.parent / "out-2" / "trajectory.csv").is_file()


def test_every_limit_is_told_on_a_narrow_terminal_and_where_a_slide_starts_in_metres(
    arm: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    slide = 'name="lift" type="slide" axis="0 0 1" range="-0.123 0.234"'
    text = arm.read_text().replace('name="lift" axis="0 1 0" range="-2.5 2.5"', slide)
    arm.write_text(text.replace('"turn"', '"shoulder_of_the_left_arm_joint1"'))
    out = arm.parent / "out"
    assert main(["excite", str(arm), "--out", str(out), "--duration", "6", "--budget", "1", "-q"]) == 0
    said = capsys.readouterr().out
    assert "\N{HORIZONTAL ELLIPSIS}" not in said
    assert re.search(r"bring the arm to its start first: .*lift [-.\d]+ m, bend [-.\d]+ rad\n", said)


def test_the_same_seed_gives_the_same_motion_and_json_is_for_scripts(
    arm: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = []
    for name in ("a", "b"):
        args = ["excite", str(arm), "--out", str(arm.parent / name), "--duration", "4", "--seed", "3", "--json", "-q"]
        assert main([*args, "--criterion", "prediction", "--budget", "100"]) == 0
        found.append(json.loads(capsys.readouterr().out))
    assert found[0]["starts_at"] == found[1]["starts_at"]
    assert all(p["percent"] > 0 for p in found[0]["parameters"])


def test_via_points_keep_the_tool_in_its_box(arm: Path) -> None:
    from trueup.excitation.chain import Chain
    from trueup.identification.model_file import load_tree

    (arm.parent / "cell.toml").write_text(REGION)
    out = arm.parent / "out"
    args = ["excite", str(arm), "--region", str(arm.parent / "cell.toml"), "--via-points", "5", "--out", str(out), "-q"]
    assert main([*args, "--duration", "6", "--budget", "1"]) == 0
    (recording,) = read(out / "trajectory.csv")
    q = recording.channel("position").select(("turn", "lift", "bend")).values
    tool = Chain.of(load_tree(arm), tool=[0.35, 0.0, 0.0]).poses(q)[1]
    assert (np.abs(tool - [0.45, 0.1, 0.6]) <= np.array([0.1, 0.15, 0.1]) + 1e-5).all()


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--via-points", "6"], "needs a region"),
        (["--floor", "low"], "choices are auto, none, or a height"),
        (["--duration", "-3"], "a number above 0 is needed"),
        (["--gravity", "nan", "0", "0"], "three finite numbers are needed"),
        (["--region", "nowhere.toml"], "no such file"),
        (["--limits", "limits.toml"], "joint 'bnd' is not in the model"),
        (["--region", "far.toml"], "no posture reaches the middle of the box"),
        (["--region", "low.toml", "--margin", "10"], "collides"),
    ],
)
def test_what_cannot_be_is_said_with_what_to_do(
    arm: Path, more: list[str], said: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(arm.parent)
    Path("limits.toml").write_text("[joints.bnd]\nspeed = 1.0\n")
    Path("far.toml").write_text("[box]\ncentre = [4.0, 0, 0]\nsize = [0.1, 0.1, 0.1]\n")
    Path("low.toml").write_text("tool = [0.35, 0, 0]\n[box]\ncentre = [0.05, 0, 0.08]\nsize = [0.1, 0.1, 0.02]\n")
    assert main(["excite", "arm.xml", "--out", "out", *more]) == 1
    assert said in " ".join(capsys.readouterr().err.split())


def test_a_limits_file_is_kept(arm: Path) -> None:
    (arm.parent / "limits.toml").write_text("[all]\nacceleration = 3.0\n[joints.bend]\nspeed = 0.5\n")
    out = arm.parent / "out"
    args = ["excite", str(arm), "--limits", str(arm.parent / "limits.toml"), "--out", str(out), "-q", "--budget", "1"]
    assert main([*args, "--duration", "8"]) == 0
    table = np.genfromtxt(out / "trajectory.csv", delimiter=",", names=True)
    assert np.abs(table["vel_bend"]).max() <= 0.5
    assert max(np.abs(table[f"acc_{j}"]).max() for j in ("turn", "lift", "bend")) <= 3.0


def test_an_arm_on_a_wall_keeps_its_torque_limits_there(arm: Path) -> None:
    """`turn` carries weight on a wall only, where it takes more than an upright arm's motion does."""
    from trueup.identification.model_file import load_tree
    from trueup.identification.regressors import inverse_dynamics

    arm.write_text(arm.read_text().replace('"-80 80"', '"-25 25"'))
    out = arm.parent / "out"
    args = ["excite", str(arm), "--out", str(out), "--duration", "8", "--motion", "fourier", "--budget", "1", "-q"]
    assert main([*args, "--gravity", "9.81", "0", "0"]) == 0
    (recording,) = read(out / "trajectory.csv")
    wall = load_tree(arm).replace(gravity=(9.81, 0.0, 0.0))
    q, qd, qdd = (recording.channel(c).select(wall.joints).values for c in ("position", "velocity", "acceleration"))
    torque = np.abs(inverse_dynamics(wall, wall.weighed(), q, qd, qdd)).max(axis=0)
    assert (torque <= [25.0, 90.0, 40.0]).all()
    told = json.loads((out / "trajectory.json").read_text())
    assert np.allclose(told["taken"]["peak"], torque, rtol=0.02)


def test_gravity_in_other_units_is_said(arm: Path, capsys: pytest.CaptureFixture[str]) -> None:
    args = [
        "excite",
        str(arm),
        "--out",
        str(arm.parent / "out"),
        "--duration",
        "6",
        "--motion",
        "fourier",
        "--budget",
        "1",
    ]
    assert main([*args, "--gravity", "0", "0", "-1"]) == 0
    assert "on Earth it is 9.81, in that direction --gravity 0 0 -9.81" in " ".join(capsys.readouterr().err.split())


def test_no_arm_jumps_between_the_passes_of_a_motion(arm: Path) -> None:
    """Sines do not end where they begin: their path is gone back, and what is written moves as its speeds say."""
    out = arm.parent / "out"
    asked = ["excite", str(arm), "--motion", "sines", "--duration", "24", "--budget", "1", "--out", str(out), "-q"]
    assert main(asked) == 0
    (recording,) = read(out / "trajectory.csv")
    position, speed = (recording.channel(name) for name in ("position", "velocity"))
    assert len(json.loads((out / "trajectory.json").read_text())["passes"]) > 1
    moved = np.gradient(position.values, position.time, axis=0)
    assert np.abs(moved - speed.values).max() < 0.02


def test_a_mix_of_classes_is_the_default_and_keeps_all_limits(arm: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = []
    for name in ("a", "b"):
        asked = [
            "excite",
            str(arm),
            "--duration",
            "30",
            "--out",
            str(arm.parent / name),
            "--json",
            "-q",
        ]
        assert main(asked) == 0
        found.append(json.loads(capsys.readouterr().out))
    plan = found[0]
    assert plan == {**found[1], "seconds_of_search": plan["seconds_of_search"]}, (
        "the search ends by a count, not a clock"
    )
    assert "moves" in plan["mix"]
    assert 20.0 < plan["duration"] <= 30.0
    taken, limits = plan["taken"], plan["limits"]
    for name in ("upper", "speed", "acceleration", "torque", "peak"):
        assert all(x <= most * (1 + 1e-6) for x, most in zip(taken[name], limits[name], strict=True)), name
    assert set(plan["limits_from"]["acceleration"]) == {"assumed"}
    assert set(plan["limits_from"]["torque"]) == {"model"}


def test_a_peak_torque_is_used_for_short_times_only(arm: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = arm.parent / "weak.toml"
    file.write_text("[joints.lift]\ntorque = 18.0\n")
    asked = [
        "excite",
        str(arm),
        "--limits",
        str(file),
        "--out",
        str(arm.parent / "out"),
        "-q",
        "--json",
        "--rate",
        "100",
    ]
    plans = []
    for more in ([], ["--peak", "4"]):
        assert main([*asked, *more]) == 0
        plans.append(json.loads(capsys.readouterr().out))
    most, lasting = ([plan["taken"][name][1] for plan in plans] for name in ("peak", "torque"))
    assert most[0] <= 18.0 * (1 + 1e-6)
    assert 18.0 < most[1] <= 4 * 18.0
    assert lasting[1] <= 18.0
    assert plans[1]["limits_from"]["peak"] == ["--peak 4"] * 3
    assert plans[1]["limits_from"]["torque"] == ["model", "weak.toml", "model"]
    file.write_text("[joints.lift]\ntorque = 0.01\n")
    assert main(asked) == 1
    assert "--peak" in capsys.readouterr().err


def test_what_is_expected_follows_from_what_an_earlier_fit_left(arm: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, found = arm.parent / "fit", []
    folder.mkdir()
    asked = ["excite", str(arm), "--duration", "20", "--rate", "100", "--out", str(arm.parent / "out"), "--json"]
    for density in (1e-8, 4e-8, 0.01, 0.04):
        left = {"joints": ["lift", "turn", "bend"], "error_density": [density] * 3}
        (folder / "identification.json").write_text(json.dumps(left))
        assert main([*asked, "--after", str(folder)]) == 0
        plan = json.loads(capsys.readouterr().out)
        found.append({p["name"]: p["deviation"] for p in plan["parameters"]})
    few, more, many, most = found
    assert all(more[name] == pytest.approx(2.0 * deviation, rel=0.01) for name, deviation in few.items())
    # What the log hardly tells is known from the file.
    assert all(deviation < most[name] < 2.0 * deviation for name, deviation in many.items())
    (folder / "identification.json").write_text(json.dumps({"joints": ["lift"], "error_density": [1.0]}))
    assert main([*asked, "--after", str(folder)]) == 1
    assert "does not say which errors were left" in " ".join(capsys.readouterr().err.split())
