# SPDX-License-Identifier: Apache-2.0
"""Channels of a robot's gyro and accelerometer are compared with those of its model, whatever their columns are called."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trueup.cli import main
from trueup.inspection.sensors import sensed
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording

_ARM = """<mujoco><worldbody><body><joint name="j" axis="0 1 0"/><geom size=".05" mass="1" pos=".1 0 0"/><site name="s"/>
</body></worldbody><actuator><position joint="j"/></actuator><sensor><gyro name="imu_gyro" site="s"/>
<accelerometer name="imu_acc" site="s"/>{}</sensor></mujoco>"""
_SENSORS = {"imu_acc": "m/s^2", "imu_gyro": "rad/s", "field": ""}
_TIME = np.arange(0.0, 2.0, 0.02)


def log(**units: str) -> Recording:
    """A swing with channels of x, y and z in these units."""
    swing = {n: Channel(n, ("j",), "rad", _TIME, np.sin(_TIME)[:, None]) for n in ("position", "command")}
    values = np.outer(np.cos(_TIME), (0.0, 1.0, 0.0))
    return Recording("run", swing | {n: Channel(n, ("x", "y", "z"), unit, _TIME, values) for n, unit in units.items()})


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (("imu_acc", "imu_gyro"), {"imu_acc": "imu_acc", "imu_gyro": "imu_gyro"}),
        (("acc", "gyro"), {"acc": "imu_acc", "gyro": "imu_gyro"}),
        (
            ("linear_acceleration", "angular_velocity"),
            {"linear_acceleration": "imu_acc", "angular_velocity": "imu_gyro"},
        ),
        (("field", "force"), {"field": "field"}),
        (("acc_left", "acc_right"), {}),
        (("imu_acc", "acc"), {"imu_acc": "imu_acc"}),
    ],
)
def test_a_channel_is_the_sensor_of_its_name_or_the_only_one_of_its_kind(
    names: tuple[str, ...], found: dict[str, str]
) -> None:
    assert sensed([log(**dict.fromkeys(names, ""))], _SENSORS) == found


def test_of_two_gyros_none_is_chosen(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(_ARM.format('<gyro name="other" site="s"/>'))
    ready = prepare(tmp_path / "arm.xml", [log(gyro="rad/s", acc="m/s^2")], propose=False)
    assert ready.simulator.observable(ready.recordings[0]) == ("position", "acc")
    assert any("gyro" in note for note in ready.unused())


def test_sensors_are_compared_in_their_units_alone_and_not_where_that_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(_ARM.format(""))
    ready = prepare(path, [log(gyro="rad/s", acc="")], propose=False)
    assert ready.recordings[0].channel("gyro").labels == ("imu_gyro.x", "imu_gyro.y", "imu_gyro.z")
    assert ready.simulator.observable(ready.recordings[0]) == ("position", "gyro")
    assert any("'acc' seems to be the model's sensor 'imu_acc', yet its unit is ''" in note for note in ready.notes)
    refused = prepare(path, [log(gyro="rad/s", acc="")], propose=False, refuse=["sensors"])
    assert refused.simulator.observable(refused.recordings[0]) == ("position",)


def test_inspect_labels_them_in_its_mapping(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "arm.xml").write_text(_ARM.format(""))
    names = [
        "time",
        "goal_position",
        "present_position",
        *(f"{kind}_{axis}" for kind in ("gyro", "acc") for axis in "xyz"),
    ]
    run = log(gyro="rad/s", acc="m/s^2")
    columns = [run.channel(n).values for n in ("command", "position", "gyro", "acc")]
    np.savetxt(
        tmp_path / "log.csv", np.column_stack([_TIME, *columns]), delimiter=",", header=",".join(names), comments=""
    )
    monkeypatch.chdir(tmp_path)
    assert main(["inspect", "log.csv", "--model", "arm.xml"]) == 0
    assert 'labels = ["imu_gyro.x", "imu_gyro.y", "imu_gyro.z"]' in (tmp_path / "mapping.toml").read_text()
