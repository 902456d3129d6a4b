# SPDX-License-Identifier: Apache-2.0
"""Logs and model that differ in their joints: what is locked, what is strange to the model, and how to say what is what."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from trueup.cli import main
from trueup.errors import UnknownNameError
from trueup.identification.estimation.identify import identify
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


def test_columns_that_count_all_joints_are_theirs_where_one_is_locked_and_its_motion_is_said(
    arms: SimpleNamespace,
) -> None:
    tree, made = arms.arm(), arms.recording(arms.arm(), np.random.default_rng(3), seconds=4.0)
    tree = tree.replace(joints=("waist", "upper", "elbow", "wrist"))
    counted = made.rename(dict(zip(made.channel("position").labels, ("A1", "A2", "A3", "A4"), strict=True)))
    locked, ((log,), _), (by_order, moving) = matched(tree, ([counted], []), lock=["upper"])
    assert locked.joints == ("waist", "elbow", "wrist")
    assert "A3 -> elbow" in by_order
    assert "upper moves from" in moving
    np.testing.assert_array_equal(log.channel("torque").column("elbow"), made.channel("torque").values[:, 2])
    three = [counted.channel(name).select(["A1", "A3", "A4"]) for name in ("position", "torque")]
    renamed = counted.replace(channels={c.name: c for c in three}).rename({"A3": "A2", "A4": "A3"})
    _, ((log,), _), (by_order,) = matched(tree, ([renamed], []), lock=["upper"])
    assert "A2 -> elbow" in by_order


def test_a_torque_that_a_log_lacks_is_named_by_its_joint_where_columns_only_count(arms: SimpleNamespace) -> None:
    tree, made = arms.arm(), arms.recording(arms.arm(), np.random.default_rng(3), seconds=4.0)
    tree = tree.replace(joints=("waist", "upper", "elbow", "wrist"))
    place, torque = made.channel("position"), made.channel("torque").select(["joint1", "joint2", "joint4"])
    place = place.replace(labels=("A1", "A2", "A3", "A4"))
    log = made.replace(channels={"position": place, "torque": torque.replace(labels=("joint_1", "joint_2", "joint_4"))})
    with pytest.raises(UnknownNameError, match=r"column 'elbow' is not in channel 'torque'.*are: upper, waist, wrist"):
        identify(tree, [log])


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


def test_positions_without_a_unit_are_degrees_where_they_fit_the_ranges_only_so(arms: SimpleNamespace) -> None:
    tree = arms.arm().replace(lower=np.full(4, -3.0), upper=np.full(4, 3.0))
    made = arms.recording(tree, np.random.default_rng(3), seconds=4.0, size=1.0)
    q = made.channel("position")
    turned = made.with_channel(q.replace(unit="", values=np.degrees(q.values)))
    _, ((log,), _), (said,) = matched(tree, ([turned], []))
    np.testing.assert_allclose(log.channel("position").values, q.values)
    assert "taken as degrees" in said
    _, ((geared,), _), none = matched(tree, ([turned], []), at_motors=True)
    np.testing.assert_allclose(geared.channel("position").values, np.degrees(q.values))
    assert not none
