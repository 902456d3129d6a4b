# SPDX-License-Identifier: Apache-2.0
"""Logs and model that differ in their joints: what is locked, what is strange to the model, and how to say what is what."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from trueup.cli import main
from trueup.identification.estimation.matching import matched


def test_joints_that_logs_lack_are_named_with_those_that_the_model_lacks(arms: SimpleNamespace) -> None:
    log = arms.recording(arms.arm(), np.random.default_rng(3), seconds=4.0)
    log = log.rename(dict(zip(log.channel("position").labels, ("waist", "upper", "elbow", "wrist"), strict=True)))
    tree = arms.arm().replace(joints=("x1", "x2", "elbow", "wrist"))
    locked, _, (note,) = matched(tree, ([log], []))
    assert locked.joints == ("elbow", "wrist")
    assert "no log has x1, x2" in note
    assert "the logs have waist, upper, which the model lacks" in note
    assert "[joints]" in note
    fewer = [log.channel(name).select(["elbow", "wrist"]) for name in ("position", "torque")]
    _, _, (plain,) = matched(tree, ([log.replace(channels={c.name: c for c in fewer})], []))
    assert plain == "no log has x1, x2: locked at zero"


ARM = """<robot name="arm"><link name="l0"/><link name="l1"/><link name="l2"/>
<joint name="base_yaw" type="revolute"><parent link="l0"/><child link="l1"/><axis xyz="0 0 1"/></joint>
<joint name="elbow" type="revolute"><parent link="l1"/><child link="l2"/><axis xyz="0 1 0"/></joint></robot>
"""


def test_drives_of_joints_that_are_locked_are_no_mistake(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("arm.urdf").write_text(ARM)
    Path("drives.toml").write_text("[joints.base_yaw]\nratio = 100.0\n[joints.elbow]\nratio = 50.0\n")
    rows = (f"{k / 100},{np.sin(0.1 * k)}" for k in range(300))
    Path("log.csv").write_text("time,q_elbow\n" + "\n".join(rows) + "\n")
    command = ["identify", "arm.urdf", "log.csv", "--drives", "drives.toml", "--out", "m"]
    assert main(command) == 1
    said = capsys.readouterr().err
    assert "is not in the model" not in said
    assert "no channel 'torque'" in said
    Path("drives.toml").write_text("[joints.elbo]\nratio = 50.0\n")
    assert main(command) == 1
    assert "joints are: base_yaw, elbow" in " ".join(capsys.readouterr().err.split()), "all joints are choices"
