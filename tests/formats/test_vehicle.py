# SPDX-License-Identifier: Apache-2.0
"""A car's log is recognised whatever its columns are called: throttle and steering, pose, heading, speed, in SI units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.formats import read

Array = NDArray[np.float64]

LAYOUTS = {
    "plain": "t,throttle,steer,x,y,yaw,v",
    "commands": "time,throttle_cmd,steering_cmd,pos_x,pos_y,theta,speed",
    "units": "timestamp,throttle_percent,steering_angle_cmd,x_mm,y_mm,yaw_deg,wheel_speed",
    "tracked": "stamp,cmd_throttle,cmd_steer,mocap_x,mocap_y,mocap_yaw,encoder_speed",
    "odometry": "time,u_throttle,u_steering,odom_x,odom_y,odom_heading,vx",
}


def drive() -> tuple[Array, ...]:
    """Time, throttle, steering, x, y, heading and speed of a car on a winding way."""
    t = np.arange(0.0, 20.0, 0.02)
    throttle, steering = 0.2 + 0.1 * np.sin(t), 0.3 * np.sin(0.5 * t)
    speed = 1.0 + 0.3 * np.sin(t - 0.3)
    heading = np.cumsum(speed * np.tan(0.3 * steering) / 0.3 * 0.02)
    return (t, throttle, steering, np.cumsum(speed * np.cos(heading) * 0.02), np.cumsum(speed * np.sin(heading) * 0.02),
            heading, speed)  # fmt: skip


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_cars_log_is_recognised_whatever_its_columns_are_called(layout: str, tmp_path: Path) -> None:
    t, throttle, steering, x, y, heading, speed = drive()
    shown = [throttle, steering, x, y, heading, speed]
    if layout == "units":
        shown = [100 * throttle, steering, 1e3 * x, 1e3 * y, np.degrees(heading), speed]
    path = tmp_path / "drive.csv"
    np.savetxt(path, np.column_stack([t, *shown]), delimiter=",", header=LAYOUTS[layout], comments="", fmt="%.7f")
    recording = read([path])[0]
    for channel, label, truth in (
        ("command", "throttle", throttle), ("command", "steering", steering), ("position", "x", x), ("position", "y", y),
        ("heading", "heading", heading), ("speed", "speed", speed),
    ):  # fmt: skip
        assert recording.channel(channel).column(label) == pytest.approx(truth, abs=2e-6), (channel, label)


def test_a_commanded_speed_is_a_cars_drive_and_a_quaternion_is_kept(tmp_path: Path) -> None:
    t, _, steering, x, y, heading, speed = drive()
    zero = np.zeros(len(t))
    path = tmp_path / "drive.csv"
    names = "time,cmd_speed_mps,cmd_steering_deg,pose.x,pose.y,pose.z,pose.qx,pose.qy,pose.qz,pose.qw,wheel_speed"
    shown = [t, speed, np.degrees(steering), x, y, zero, zero, zero, np.sin(heading / 2), np.cos(heading / 2), speed]
    np.savetxt(path, np.column_stack(shown), delimiter=",", header=names, comments="", fmt="%.7f")
    recording = read([path])[0]
    assert recording.channel("command").column("speed") == pytest.approx(speed, abs=2e-6)
    assert np.corrcoef(recording.channel("command").column("steering"), steering)[0, 1] > 0.9999
    assert recording.channel("position").column("x") == pytest.approx(x, abs=2e-6)
    assert recording.channel("orientation").column("qz") == pytest.approx(np.sin(heading / 2), abs=2e-6)
    assert recording.channel("speed").column("speed") == pytest.approx(speed, abs=2e-6)
