# SPDX-License-Identifier: Apache-2.0
"""`trueup calibrate --beyond-mjcf` and `--step`: friction that a model file cannot hold, at the step it was made with."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import mujoco
import numpy as np
import pytest

from trueup.calibration import Calibration
from trueup.cli import main
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.mujoco.writing.notes import about_load

GEARED = """<mujoco model="geared"><option integrator="implicitfast" timestep="0.001"/>
  <default><joint solimpfriction="0.999 0.999 0.001"/></default>
  <worldbody><body><joint name="hinge" axis="0 1 0" damping="0.1" frictionloss="0.02" armature="0.01"/>
  <inertial pos="0.1 0 0" mass="0.8" diaginertia="0.001 0.001 0.001"/></body></worldbody>
  <actuator><position name="hinge" joint="hinge" kp="8"/></actuator></mujoco>"""
SHARE = 0.3  # of the servo's torque is lost to friction
NOISE = 1e-4  # rad


@pytest.fixture
def geared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder with a pendulum's model, and a log of one whose gears are pressed together by what they carry."""
    monkeypatch.chdir(tmp_path)
    write_log(SHARE)


def write_log(share: float) -> None:
    Path("geared.xml").write_text(GEARED)
    model = mujoco.MjModel.from_xml_string(GEARED)
    data, rng, lines = mujoco.MjData(model), np.random.default_rng(0), ["time,cmd_hinge,pos_hinge"]
    for k in range(200):
        t = 0.01 * k
        data.ctrl[0] = 0.6 * np.sin(1.5 * t) + 0.2 * np.sin(4.1 * t)
        lines.append(f"{t:.6f},{data.ctrl[0]:.6f},{data.qpos[0] + NOISE * rng.standard_normal():.6f}")
        for _ in range(10):
            model.dof_frictionloss[0] = 0.02 + share * abs(data.qfrc_actuator[0])
            mujoco.mj_step(model, data)
    Path("log.csv").write_text("\n".join(lines) + "\n")


def said(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(words) == 0
    heard = capsys.readouterr()
    return " ".join((heard.out + heard.err).split())


@pytest.mark.usefixtures("geared")
def test_friction_that_grows_with_the_load_is_hinted_at_and_found_when_asked_for(
    capsys: pytest.CaptureFixture[str],
) -> None:
    plain = said(capsys, "calibrate", "geared.xml", "log.csv", "--out", "plain")
    assert "here it is simulated at" not in plain
    assert "times the noise" in plain
    assert "--beyond-mjcf tries that too" in plain
    loaded = said(
        capsys,
        "calibrate",
        "geared.xml",
        "log.csv",
        "--beyond-mjcf",
        "--step",
        "0.001",
        "--no-lacking",
        "--out",
        "loaded",
    )
    assert "friction that grows with load (hinge) is no part of MJCF" in loaded
    assert "times the noise" not in loaded
    found = {p["name"]: p["value"] for p in json.loads(Path("loaded/calibration.json").read_text())["parameters"]}
    assert found["hinge.friction_load"] == pytest.approx(SHARE, abs=0.03)
    errors = []
    for step in ("0.001", "0.01"):
        replay = ("replay", "geared.xml", "log.csv", "--parameters", "loaded/parameters.toml", "--json", "-q")
        errors.append(json.loads(said(capsys, *replay, "--step", step))[0]["rmse"][0])
    assert errors[0] < 3 * NOISE < errors[1]


@pytest.mark.parametrize(("astray", "hinted"), [(0.3, False), (1.0, True)])
def test_only_what_is_usually_far_off_hints_at_friction_with_load(astray: float, hinted: bool) -> None:
    off = np.random.default_rng(0).standard_normal((200, 2))
    off[: round(astray * len(off))] += 30.0
    replay = SimpleNamespace(channel="position", after=off, measured=np.zeros_like(off), noise=np.ones(2))
    servo = cast(MujocoSimulator, SimpleNamespace(quantities=(SimpleNamespace(kind="kp"),), touches=False))
    calibration = cast(Calibration, SimpleNamespace(lacking="", training=lambda: [replay]))
    assert bool(about_load(servo, calibration)) == hinted


@pytest.mark.usefixtures("geared")
def test_friction_with_load_that_the_robot_does_not_have_is_left_at_zero(capsys: pytest.CaptureFixture[str]) -> None:
    write_log(share=0.0)
    words = ("calibrate", "geared.xml", "log.csv", "--beyond-mjcf", "--step", "0.001", "--out", "loaded")
    assert "friction with load left out" in said(capsys, *words)
    numbers = json.loads(Path("loaded/calibration.json").read_text())
    assert {p["name"]: p["value"] for p in numbers["parameters"]}["hinge.friction_load"] == 0.0
    assert numbers["replays"][0]["rmse_after"][0] < 1.5 * NOISE


@pytest.mark.usefixtures("geared")
@pytest.mark.parametrize("step", ["1", "2 ms", "0"])
def test_a_step_that_is_none_is_refused_with_its_unit(step: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(("calibrate", "geared.xml", "log.csv", "--step", step, "--out", "fit")) == 2
    assert f"0.00001 to 0.02 s (0.001 is 1 ms), not '{step}'" in capsys.readouterr().err
