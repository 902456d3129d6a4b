# SPDX-License-Identifier: Apache-2.0
"""A car's log is recognised whatever its columns are called: throttle and steering, pose, heading, speed, in SI units."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.errors import RecordingError
from trueup.formats import read
from trueup.inspection import inspect
from trueup.model_files.joint_names import joint_names
from trueup.recording import Channel, Recording
from trueup.tracking.commands import driven_by
from trueup.tracking.heading import course, heading_of

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


def test_where_x_is_north_the_place_is_still_x_to_the_east_so_that_left_stays_left(tmp_path: Path) -> None:
    t, throttle, steering, x, y, heading, _ = drive()
    path = tmp_path / "ned.csv"
    shown = [t, throttle, steering, y, x, (90.0 - np.degrees(heading)) % 360.0]
    names = "t,throttle,steering,x_north_m,y_east_m,heading_deg"
    np.savetxt(path, np.column_stack(shown), delimiter=",", header=names, comments="", fmt="%.7f")
    recording = read([path])[0]
    assert recording.channel("position").select(("x", "y")).values == pytest.approx(np.column_stack([x, y]), abs=1e-6)


@pytest.mark.parametrize("rate", [5.0, 10.0])
def test_the_direction_of_motion_from_sparse_fixes_does_not_lag_behind_curves(rate: float) -> None:
    t = np.arange(0.0, 60.0, 1.0 / rate)
    fine = np.arange(0.0, 60.0, 0.001)
    heading = 2.0 * np.sin(0.6 * fine)
    way = np.cumsum(3.0 * np.stack([np.cos(heading), np.sin(heading)], axis=1) * 0.001, axis=0)
    noise = np.random.default_rng(0).normal(0.0, 0.01, (len(t), 2))
    place = Channel("position", ("x", "y"), "m", t, np.stack([np.interp(t, fine, w) for w in way.T], axis=1) + noise)
    found = course(place, np.ones(len(t), dtype=bool)).values[:, 0]
    error = (found - np.interp(t, fine, heading))[int(3 * rate) :]
    assert np.sqrt(np.mean(error**2)) < 0.05  # of parabolas through 1.8 s, ten fixes of 5 Hz: 0.18 rad


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


FULL_SIZE = (
    "time_s,steering_wheel_angle_deg,throttle_pct,brake_pct,gps_lat,gps_lon,heading_deg,speed_kmh",
    "t,throttle,brake,steering,easting,northing,yaw,v",
    "stamp,drive.speed,drive.steering_angle,pose.position.x,pose.position.y,pose.orientation.x,pose.orientation.y,"
    "pose.orientation.z,pose.orientation.w,twist.linear.x,twist.angular.z",
    "timestamp,erpm_cmd,servo_cmd,odom_speed,pf_x,pf_y,pf_theta",
    "time,cmd_v,cmd_w,x,y,theta",
    "timestamp,throttle,steering,pos_x,pos_y,pos_z,roll,pitch,yaw,speed",
    "time,cmd_vel.linear.x,cmd_vel.angular.z,pose_x,pose_y,pose_yaw_deg,odom_v,odom_w",
    "sim_time,throttle,brake,steer,location_x,location_y,rotation_yaw,speed_kmh",
    "timestamp,throttle_pwm_us,steering_pwm_us,rb_pos_x,rb_pos_y,rb_pos_z,rb_rot_x,rb_rot_y,rb_rot_z,rb_rot_w",
    "t,cmd_vel_linear,cmd_vel_angular,north_m,east_m,yaw_ned_deg,wheel_odom_speed",
    "time,speed_percent,steering_deg,uwb_x,uwb_y,compass_deg,gyro_dps",
    "epoch,cmd_lin,cmd_ang,x,y,theta",
    "t,lin_vel_cmd,ang_vel_cmd,odom_x,odom_y,odom_theta,v_odom",
    "time,user/throttle,user/steering,pos/x,pos/y,pos/yaw",
)


@pytest.mark.parametrize("names", FULL_SIZE)
def test_logs_of_golf_carts_racing_cars_and_two_wheelers_are_recognised(names: str, tmp_path: Path) -> None:
    """Pedals, steering wheels, receivers, motor controllers, quaternions, turn rates: each has a place and a direction."""
    t, throttle, steering, x, y, heading, speed = drive()
    signals = {
        "time": t, "throttle": throttle, "brake": 0 * t, "steer": steering, "servo": 0.5 - steering, "erpm": 4000 * speed,
        "lat": 48.0 + x * 1e-5, "lon": 11.0 + y * 1e-5, "easting": 7e5 + x, "northing": 5e6 + y,
        "orientation.z": np.sin(heading / 2), "orientation.w": np.cos(heading / 2), "rot_x": 0 * t, "rot_y": 0 * t,
        "rot_z": np.sin(heading / 2), "rot_w": np.cos(heading / 2), "yaw": heading, "theta": heading,
        "heading": np.degrees(heading), "x": x, "y": y, "kmh": 3.6 * speed, "speed": speed, "v": speed, "w": steering,
    }  # fmt: skip
    order = ("rot_x", "rot_y", "rot_z", "rot_w", "orientation.z", "orientation.w", "orientation", "steer", "servo", "erpm",
             "throttle", "brake", "theta", "yaw", "heading", "lat", "lon", "easting", "northing", "kmh", "time", "stamp",
             "angular", "linear", "speed")  # fmt: skip

    def signal(name: str) -> Array:
        key = next((k for k in order if k in name), name.split("_")[-1].split(".")[-1])
        return signals.get(
            {
                "stamp": "time",
                "epoch": "time",
                "linear": "speed",
                "angular": "w",
                "lin": "speed",
                "ang": "w",
                "odom": "speed",
                "t": "time",
            }.get(key, key),
            0 * t,
        )

    path = tmp_path / "drive.csv"
    columns = [signal(name) for name in names.split(",")]
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=names, comments="", fmt="%.9f")
    recording = read([path])[0]
    command = recording.channel("command")
    assert {"steering", "turn"} & set(command.labels)
    assert {"throttle", "speed"} & set(command.labels)
    position = recording.channel("position")
    assert position.labels in (("x", "y"), ("latitude", "longitude"))
    assert position.unit == ("m" if "x" in position.labels else "rad")
    assert recording.has("heading") or recording.channel("orientation").labels == ("qx", "qy", "qz", "qw")
    if recording.has("speed"):
        assert recording.channel("speed").values[:, 0] == pytest.approx(speed, abs=1e-6)


@pytest.mark.parametrize("names", ["linear.x,angular.z,x,y,theta", "twist.linear.x,twist.angular.z,pose.x,pose.y,pose.theta",
                                   "v,w,x,y,yaw", "longitudinal.velocity,lateral.steering_tire_angle,x,y,yaw"])  # fmt: skip
@pytest.mark.parametrize("late", [0.3, -0.1])
def test_a_speed_that_nobody_calls_a_command_is_one_where_the_motion_follows_it(
    names: str, late: float, tmp_path: Path
) -> None:
    t, rng = np.arange(0.0, 25.0, 0.05), np.random.default_rng(0)
    speed, turn = (
        (lambda s: 1.0 + 0.5 * np.sin(0.7 * s) + 0.2 * np.sin(2.1 * s)),
        (lambda s: 0.6 * np.sin(0.9 * s + 1.0)),
    )
    heading = np.cumsum(turn(t - late) * 0.05)
    x, y = (np.cumsum(speed(t - late) * f(heading) * 0.05) + rng.normal(0.0, 3e-3, len(t)) for f in (np.cos, np.sin))
    wrapped = np.mod(heading + np.pi, 2.0 * np.pi) - np.pi
    columns = np.column_stack([t, speed(t), turn(t), x, y, wrapped])
    np.savetxt(tmp_path / "log.csv", columns, delimiter=",", header="t," + names, comments="")
    recording = read([tmp_path / "log.csv"])[0]
    commands = {label for name, c in recording.channels.items() if name.startswith("command") for label in c.labels}
    assert ("speed" in commands) == (late > 0.0)
    assert ("the motion follows" in recording.provenance["guesses"]) == (late > 0.0)


def test_a_speed_sideways_is_said_not_to_be_simulated(tmp_path: Path) -> None:
    t, _, steering, x, y, heading, speed = drive()
    for sideways in (0.0 * t, steering):
        columns = np.column_stack([t, speed, sideways, steering, x, y, heading])
        names = "t,cmd_vel.linear.x,cmd_vel.linear.y,cmd_vel.angular.z,x,y,yaw"
        np.savetxt(tmp_path / "log.csv", columns, delimiter=",", header=names, comments="")
        recording = read([tmp_path / "log.csv"])[0]
        assert ("sideways" in recording.provenance["guesses"]) == bool(sideways.any())
        if sideways.any():
            with pytest.raises(RecordingError, match=r"sideways, as of mecanum.* is commanded, up to [\d.]+ m/s"):
                driven_by(recording)
            joystick = np.where([[True, True, False]], recording.channel("command").values, 1e-4)
            driven_by(recording.with_channel(recording.channel("command").replace(values=joystick)))
        else:
            driven_by(recording)


def test_a_speed_sideways_is_one_that_is_commanded_where_the_motion_follows_the_speed_beside_it(tmp_path: Path) -> None:
    """It was left aside as a signal of which nothing was known, and the robot calibrated as one that only turns."""
    t = np.arange(0.0, 25.0, 0.05)
    speed, aside, turn = (
        lambda s: 1.0 + 0.5 * np.sin(0.7 * s) + 0.2 * np.sin(2.1 * s),
        lambda s: 0.4 * np.sin(1.3 * s),
        lambda s: 0.6 * np.sin(0.9 * s + 1.0),
    )
    heading, v, u = np.cumsum(turn(t - 0.3) * 0.05), speed(t - 0.3), aside(t - 0.3)
    x = np.cumsum(v * np.cos(heading) - u * np.sin(heading)) * 0.05
    y = np.cumsum(v * np.sin(heading) + u * np.cos(heading)) * 0.05
    wrapped = np.mod(heading + np.pi, 2.0 * np.pi) - np.pi
    np.savetxt(tmp_path / "log.csv", np.column_stack([t, speed(t), aside(t), turn(t), x, y, wrapped]), delimiter=",",
               header="t,linear_x,linear_y,angular_z,x,y,yaw", comments="")  # fmt: skip
    with pytest.raises(RecordingError, match=r"sideways, as of mecanum.* is commanded, up to 0\.4 m/s"):
        driven_by(read([tmp_path / "log.csv"])[0])


def test_an_angle_of_the_rear_wheels_too_is_said_not_to_be_simulated(tmp_path: Path) -> None:
    t, _, steering, x, y, heading, speed = drive()
    for rear in (0.0 * t, 0.5 * steering[::-1]):
        columns = np.column_stack([t, speed, rear, steering, x, y, heading])
        names = "t,speed_cmd,rear_steering_cmd,front_steering_cmd,x,y,yaw"
        np.savetxt(tmp_path / "log.csv", columns, delimiter=",", header=names, comments="")
        recording = read([tmp_path / "log.csv"])[0]
        assert ("rear_steering_cmd" in recording.provenance["guesses"]) == bool(rear.any())
        np.testing.assert_allclose(recording.channel("command").column("steering"), steering)
        if rear.any():
            with pytest.raises(RecordingError, match=r"rear wheels too, .* is commanded, up to"):
                driven_by(recording)
        else:
            driven_by(recording)


def test_a_curvature_is_the_angle_with_which_a_car_of_its_wheelbase_drives_it() -> None:
    t = np.arange(0.0, 1.0, 0.1)
    values = np.column_stack([np.ones_like(t), np.full_like(t, 0.5)])
    told = Recording("log", {"command": Channel("command", ("speed", "curvature"), "m/s", t, values, ("m/s", "1/m"))})
    driven = driven_by(told, 0.4)
    assert driven.column("steering") == pytest.approx(np.arctan(0.2))
    assert driven.units == ("m/s", "rad")


@pytest.mark.parametrize(
    "names",
    [
        "t,q1_cmd,q2_cmd,q1,q2,base_v_cmd,base_w_cmd,base_x,base_y,base_theta",
        "time,arm_lift_joint_command,arm_elbow_joint_command,arm_lift_joint_position,arm_elbow_joint_position,"
        "cmd_vel_x,cmd_vel_theta,odom_x,odom_y,odom_yaw",
    ],
)
def test_an_arm_on_a_robot_of_which_a_vehicles_file_is_given_does_not_drive_it(names: str, tmp_path: Path) -> None:
    """Without the file the log is the arm's."""
    t, speed, turn, x, y, heading, _ = drive()
    table = np.stack([t, *(np.sin(t + k) for k in range(4)), speed, turn, x, y, heading], axis=1)
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=names, comments="")
    (robot,) = read(tmp_path / "log.csv", joints=joint_names(tmp_path / "base.toml"))
    assert robot.channel("command").labels == ("speed", "turn")
    assert np.allclose(robot.channel("command").values, np.stack([speed, turn], axis=1))
    assert np.allclose(robot.channel("position").values, np.stack([x, y], axis=1))
    assert np.allclose(robot.channel("heading").values[:, 0], heading)
    (arm,) = read(tmp_path / "log.csv", joints=joint_names(tmp_path / "arm.urdf"))
    assert "speed" not in arm.channel("command").labels
    assert len(arm.channel("position").labels) >= 2
    drives = [name for name in names.split(",") if name.startswith(("base_v", "base_w", "cmd_vel"))]
    said = f"{', '.join(drives)}: these look like what drives a vehicle that the joints ride on"
    assert said in arm.provenance["guesses"]


def test_a_walking_robot_with_commanded_speeds_is_no_vehicle(tmp_path: Path) -> None:
    t = np.arange(0.0, 5.0, 0.02)
    names = "time,cmd_vel_x,cmd_yaw_rate,q_hip,q_knee,base_x,base_y"
    np.savetxt(tmp_path / "walk.csv", np.column_stack([t, *(np.sin(t + k) for k in range(6))]), delimiter=",", header=names,
               comments="")  # fmt: skip
    recording = read([tmp_path / "walk.csv"])[0]
    assert {"hip", "knee"} <= set(recording.channel("position").labels)


def test_pulses_and_places_are_no_suspicious_angles(tmp_path: Path) -> None:
    t, throttle, steering, x, y, heading, _ = drive()
    names = "time,pwm_throttle,pwm_steering,x,y,yaw"
    shown = [t, 1500 + 400 * throttle, 1500 - 400 * steering, 100 + x, y, heading]
    np.savetxt(tmp_path / "drive.csv", np.column_stack(shown), delimiter=",", header=names, comments="", fmt="%.4f")
    assert not [said for said in inspect(read([tmp_path / "drive.csv"])[0]).findings() if "degrees" in said]


def test_angles_whose_unit_nobody_says_are_degrees_where_their_numbers_can_be_nothing_else(tmp_path: Path) -> None:
    t, _, steering, x, y, heading, speed = drive()
    heading = heading + 0.3 * t  # round and round, as a compass shows it
    compass = (np.degrees(heading) + 180.0) % 360.0 - 180.0
    path = tmp_path / "drive.csv"
    for wheels in (np.degrees(steering), steering):
        shown = np.column_stack([t, x, y, compass, speed, speed, wheels])
        np.savetxt(path, shown, delimiter=",", header="t,x,y,theta,v,v_cmd,steer", comments="", fmt="%.7f")
        recording = read([path])[0]
        assert recording.channel("command").column("steering") == pytest.approx(steering, abs=2e-6)
        assert recording.channel("heading").column("heading") == pytest.approx(heading, abs=2e-6)
        said = [g for g in recording.provenance["guesses"].splitlines() if "degrees" in g]
        assert len(said) == 1 + (wheels is not steering)


def test_a_speed_whose_unit_nobody_says_is_told_by_the_way_driven(tmp_path: Path) -> None:
    t, throttle, steering, x, y, heading, speed = drive()
    for factor in (1.0, 3.6):
        shown = np.column_stack([t, throttle, steering, x, y, heading, factor * speed])
        np.savetxt(tmp_path / "drive.csv", shown, delimiter=",", header=LAYOUTS["plain"], comments="", fmt="%.7f")
        recording = read([tmp_path / "drive.csv"])[0]
        assert recording.channel("speed").column("speed") == pytest.approx(speed, abs=2e-6)
        assert ("km/h" in recording.provenance["guesses"]) == (factor != 1.0)


def test_a_pose_by_itself_is_a_position_in_metres_and_a_direction(tmp_path: Path) -> None:
    t, _, _, x, y, heading, _ = drive()
    half, zero = 0.5 * heading, np.zeros(len(t))
    turn = [zero, zero, np.sin(half), np.cos(half)]
    for names, shown in (
        ("stamp_ms;X_mm;Y_mm;yaw", [1e3 * x, 1e3 * y, heading]),
        ("stamp_ms;X_mm;Y_mm;qx;qy;qz;qw", [1e3 * x, 1e3 * y, *turn]),
        ("stamp_ms;X_mm;Y_mm;Z_mm;qx;qy;qz;qw", [1e3 * x, 1e3 * y, 120.0 + zero, *turn]),
    ):
        table = np.column_stack([1e3 * t, *shown])
        np.savetxt(tmp_path / "pose.csv", table, delimiter=";", header=names, comments="", fmt="%.7f")
        (recording,) = read([tmp_path / "pose.csv"])
        place = recording.channel("base_position" if "Z_mm" in names else "position")
        assert place.column("y") == pytest.approx(y, abs=1e-6), names
        assert place.unit == "m"
        assert np.unwrap(heading_of(recording).values[:, 0]) == pytest.approx(heading, abs=1e-6), names  # type: ignore[union-attr]


@pytest.mark.parametrize(("unit", "size"), [("m", 1.0), ("cm", 100.0), ("mm", 1000.0)])
def test_a_place_without_a_unit_is_in_the_one_in_which_it_is_driven_at_the_commanded_speed(
    tmp_path: Path, unit: str, size: float
) -> None:
    t, _, steering, x, y, heading, speed = drive()
    noise = np.random.default_rng(0).normal(0.0, 0.01, (2, len(t)))
    table = np.column_stack([t, 1.1 * speed, steering, size * (x + noise[0]), size * (y + noise[1]), heading])
    np.savetxt(tmp_path / "d.csv", table, delimiter=",", header="t,cmd_speed,cmd_steering,x,y,yaw", comments="")
    (recording,) = read([tmp_path / "d.csv"])
    assert recording.channel("position").values == pytest.approx(np.stack([x + noise[0], y + noise[1]], axis=1))
    assert (f"by the commanded speed its numbers are {unit}" in recording.provenance["guesses"]) == (unit != "m")


def test_what_is_said_of_units_tells_those_of_the_file_from_those_kept(tmp_path: Path) -> None:
    t, _, steering, x, y, heading, speed = drive()
    said = {}
    for names, factors in (("t,v_cmd_mps,steer_deg,X_mm,Y_mm,yaw", 1e3), ("t,v_cmd_mps,steer_rad,x,y,yaw", 1.0)):
        wheels = np.degrees(steering) if "deg" in names else steering
        table = np.column_stack([t, speed, wheels, factors * x, factors * y, heading])
        np.savetxt(tmp_path / "drive.csv", table, delimiter=",", header=names, comments="", fmt="%.7f")
        (recording,) = read([tmp_path / "drive.csv"])
        said[factors] = recording.provenance["guesses"]
    assert "X_mm and Y_mm taken as x, y in mm, kept in m\n" in said[1e3]
    assert "v_cmd_mps and steer_deg taken as speed, steering in m/s and deg, kept in m/s and rad\n" in said[1e3]
    assert "x and y taken as x, y in m\n" in said[1.0]
    assert "kept" not in said[1.0]


def test_speeds_along_x_and_y_of_the_place_are_no_speed_along_the_vehicle(tmp_path: Path) -> None:
    """PX4's vx and vy are north and east; a robot's own are ahead and to the left."""
    time, turned = np.arange(0.0, 8.0, 0.02), 0.8 * np.arange(0.0, 8.0, 0.02)
    x, y, vx, vy = np.sin(turned), 1.0 - np.cos(turned), 0.8 * np.cos(turned), 0.8 * np.sin(turned)
    for speeds, told in (((vx, vy), False), ((0.8 + 0.0 * time, 0.01 * np.sin(9.0 * time)), True)):
        rows = np.stack([time, 0.4 + 0.1 * np.sin(time), np.cos(time), x, y, turned, *speeds], axis=1)
        np.savetxt(
            tmp_path / "drive.csv", rows, delimiter=",", header="t,throttle,steer,x,y,heading,vx,vy", comments=""
        )
        (recording,) = read(tmp_path / "drive.csv", joints=None)
        assert ("speed" in recording.channels) == told
        assert recording.channel("position").labels == ("x", "y")


def test_a_place_and_speeds_in_files_of_their_own_are_not_compared_row_by_row(tmp_path: Path) -> None:
    """AMCL's pose at 5 Hz beside odometry at 50: whether speeds were rates of the place ended in a traceback."""
    (tmp_path / "run").mkdir()
    stamp = "header.stamp.secs,header.stamp.nsecs,"
    files = {
        "cmd_vel.csv": (0.05, "twist.linear.x,twist.angular.z", lambda t: (0.5 + 0.2 * np.sin(t), np.cos(t))),
        "amcl_pose.csv": (
            0.2,
            "pose.pose.position.x,pose.pose.position.y,pose.pose.orientation.z,pose.pose.orientation.w",
            lambda t: (0.5 * t, 0.1 * np.sin(t), np.sin(0.1 * t), np.cos(0.1 * t)),
        ),
        "odom.csv": (
            0.02,
            "twist.twist.linear.x,twist.twist.linear.y,twist.twist.angular.z",
            lambda t: (0.5 + 0.1 * np.sin(t), 0.0 * t, np.cos(t - 0.2)),
        ),
    }
    for name, (step, columns, values) in files.items():
        t = np.arange(0.0, 12.0, step)
        table = np.column_stack([1.718e9 + np.floor(t), np.round((t % 1.0) * 1e9), *values(t)])
        np.savetxt(tmp_path / "run" / name, table, delimiter=",", header=stamp + columns, comments="", fmt="%.12g")
    (recording,) = read(tmp_path / "run", joints=None)
    rows = {name: len(recording.channel(name).time) for name in ("command", "position", "orientation", "speed")}
    assert rows == {"command": 240, "position": 60, "orientation": 60, "speed": 600}


def test_a_donkey_cars_catalog_is_read(tmp_path: Path) -> None:
    lines = [
        {"_index": k, "_timestamp_ms": 1.6e12 + 50.0 * k, "user/angle": 0.1 * (k % 5), "user/throttle": 0.3,
         "user/mode": "user", "pos/x": 0.05 * k, "pos/y": 0.0, "pos/theta": 0.0}
        for k in range(40)
    ]  # fmt: skip
    (tmp_path / "catalog_0.catalog").write_text("\n".join(json.dumps(line) for line in lines))
    (recording,) = read(tmp_path / "catalog_0.catalog", joints=None)
    assert recording.channel("command").labels == ("throttle", "steering")
    assert recording.channel("command").time[-1] == pytest.approx(39 * 0.05)
