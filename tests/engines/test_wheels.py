# SPDX-License-Identifier: Apache-2.0
"""Robots whose log commands a left and a right wheel are calibrated as those commanded by speed and turn rate."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup import formats
from trueup.cli import main
from trueup.engines.vehicle import Vehicle, VehicleSimulator
from trueup.engines.vehicle.commands import with_commands
from trueup.engines.vehicle.prediction import prediction_errors
from trueup.engines.vehicle.vehicle import PURSUED, TURNED
from trueup.engines.vehicle.vehicle_file import read_vehicle, write_vehicle
from trueup.errors import ModelError, ParameterError, RecordingError
from trueup.loop.calibrate import Options
from trueup.loop.fit import DESCENT
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording
from trueup.tracking.commands import driven_by
from trueup.tracking.wheels import Wheels, as_driven, unwrapped

Array = NDArray[np.float64]
TRACK, RADIUS, COUNTS = 0.2, 0.033, 1440.0
TRUE_TRACK, TRUE_RADIUS = 0.22, 0.0335
SIZES = Wheels(TRACK, RADIUS, COUNTS)
SAID = f"[vehicle]\ntrack = {TRACK}\nwheel_radius = {RADIUS}\ncounts_per_turn = {COUNTS}\n"


def drive(seconds: float, seed: int, dead: float = 0.0) -> Array:
    """(T, 8) t, wheels as told (m/s of the declared radius), pose and angles of both wheels, each with a lag of its own.

    What they are told within +- `dead` does not move them, and beyond only what is more.
    """
    rng, step = np.random.default_rng(seed), 0.004
    x = y = psi = 0.0
    speed, angle, told, rows = np.zeros(2), np.zeros(2), np.zeros(2), []
    for k in range(round(seconds / step)):
        if k % 300 == 0:
            told = rng.uniform(0.25, 0.6) + rng.uniform(-0.15, 0.15) * np.array([-1.0, 1.0])
        if k % 5 == 0:
            rows.append([k * step, *told, x, y, psi, *angle])
        speed += step / np.array([0.12, 0.15]) * ((told - np.clip(told, -dead, dead)) / RADIUS - speed)
        angle = angle + step * speed
        left, right = TRUE_RADIUS * speed
        psi += step * (right - left) / TRUE_TRACK
        x, y = (
            x + step * 0.5 * (left + right) * math.cos(psi),
            y + step * 0.5 * (left + right) * math.sin(psi),
        )
    log = np.array(rows)
    log[:, 3:6] += rng.normal(0.0, 1e-3, (len(log), 3))
    return log


DIALECTS = {
    "t,left_wheel_velocity_command,right_wheel_velocity_command,x,y,theta": 1.0 / RADIUS,
    "t,cmd_left_mps,cmd_right_mps,x,y,theta": 1.0,
    "t,rpm_left_target,rpm_right_target,x,y,theta": 60.0 / (2.0 * math.pi * RADIUS),
    "t,left_wheel_cmd,right_wheel_cmd,x,y,theta": 1000.0,
    "t,targetL,targetR,x,y,theta": COUNTS / (2.0 * math.pi * RADIUS),
}


def written(path: Path, names: str, log: Array, factor: float = 1.0) -> Path:
    np.savetxt(path, log[:, :6] * [1, factor, factor, 1, 1, 1], delimiter=",", header=names, comments="", fmt="%.7f")
    return path


@pytest.mark.parametrize("names", DIALECTS)
def test_wheels_drive_a_robot_in_whatever_unit_they_are_told(names: str, tmp_path: Path) -> None:
    log = drive(20.0, 0)
    (one,) = formats.read(written(tmp_path / "drive.csv", names, log, DIALECTS[names]))
    car, _ = with_commands(Vehicle("robot", TRACK, drive=TURNED, wheels=SIZES), [one])
    assert car.in_si
    command = VehicleSimulator(car).prepared(one).channel("command")
    assert command.column("throttle") == pytest.approx(log[:, 1:3].mean(axis=1), abs=1e-4)
    assert command.column("steering") == pytest.approx((log[:, 2] - log[:, 1]) / TRACK, abs=1e-3)


WIRED = [(swapped, signs) for swapped in (False, True) for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
"""Whether the columns of left and right are mixed up, and which way each wheel counts."""


FOUR = {
    "t,fl_cmd,fr_cmd,rl_cmd,rr_cmd,x,y,theta": 1.0 / RADIUS,
    "t,cmd_front_left_mps,cmd_front_right_mps,cmd_back_left_mps,cmd_back_right_mps,x,y,yaw": 1.0,
    "t,wFL_ref,wFR_ref,wBL_ref,wBR_ref,x,y,th": 1.0 / RADIUS,
}


@pytest.mark.parametrize("apart", [0.0, 0.2])
@pytest.mark.parametrize("names", FOUR)
def test_wheels_of_one_side_are_one_and_drive_sideways_where_they_are_told_apart(
    names: str, apart: float, tmp_path: Path
) -> None:
    log = drive(20.0, 0)
    table = np.column_stack([log[:, :3], log[:, 1] + apart, log[:, 2] - apart, log[:, 3:6]])
    table[:, 1:5] *= FOUR[names]
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=names, comments="")
    (one,) = formats.read(tmp_path / "log.csv")
    assert one.channel("command").labels == ("left", "right", "rear_left", "rear_right")
    robot = Vehicle("robot", TRACK, drive=TURNED, wheels=SIZES)
    if apart:
        with pytest.raises(RecordingError, match="wheels of one side, as of mecanum wheels, is commanded"):
            with_commands(robot, [one])
    else:
        command = VehicleSimulator(with_commands(robot, [one])[0]).prepared(one).channel("command")
        assert command.column("throttle") == pytest.approx(log[:, 1:3].mean(axis=1))
        assert command.column("steering") == pytest.approx((log[:, 2] - log[:, 1]) / TRACK)


@pytest.mark.parametrize(("swapped", "signs"), WIRED)
@pytest.mark.parametrize("names", ["pwm_left,pwm_right", "m1,m2", "motorA_cmd,motorB_cmd"])
def test_wheels_are_told_apart_by_how_the_robot_moves(
    names: str, swapped: bool, signs: tuple[int, int], tmp_path: Path
) -> None:
    log = drive(20.0, 0)
    mixed = log.copy()
    mixed[:, 1:3] = log[:, [2, 1] if swapped else [1, 2]] * signs
    (one,) = formats.read(written(tmp_path / "drive.csv", f"t,{names},x,y,theta", mixed, 100.0))
    command = one.channel("command")
    assert [label.removesuffix("_duty") for label in command.labels] == ["left", "right"]
    assert command.values == pytest.approx(100.0 * log[:, 1:3], abs=1e-4)


def test_two_motors_that_do_not_drive_where_they_turn_something_are_joints(tmp_path: Path) -> None:
    """An arm of two joints whose hand is tracked, in place and direction."""
    t = np.arange(0.0, 10.0, 0.02)
    one, other = 0.8 * np.sin(1.7 * t), 1.1 * np.sin(2.9 * t + 1.0)
    hand = np.stack([np.cos(one) + np.cos(one + other), np.sin(one) + np.sin(one + other), one + other], axis=1)
    log = np.column_stack([t, one, other, hand])
    (read,) = formats.read(written(tmp_path / "arm.csv", "t,motor1_cmd,motor2_cmd,x,y,theta", log))
    assert read.channel("command").labels == ("motor1", "motor2")


def test_a_speed_and_a_steering_without_names_are_no_two_wheels(tmp_path: Path) -> None:
    t = np.arange(0.0, 30.0, 0.05)
    speed, steered = 1.0 + 0.5 * np.sin(0.5 * t), 0.3 * np.sin(0.8 * t)
    psi = np.cumsum(0.05 * speed * np.tan(steered) / 0.3)
    place = np.cumsum(0.05 * speed[:, None] * np.stack([np.cos(psi), np.sin(psi)], axis=1), axis=0)
    log = np.column_stack([t, speed, steered, place, psi])
    (one,) = formats.read(written(tmp_path / "car.csv", "t,action_0,action_1,x,y,yaw", log))
    assert not one.has("command") or "left" not in one.channel("command").labels


def test_encoders_that_count_down_while_their_wheels_are_told_to_go_on_are_turned_round(tmp_path: Path) -> None:
    log = drive(20.0, 0)
    table = np.column_stack([log[:, :3], log[:, 6], -log[:, 7]])
    path = tmp_path / "drive.csv"
    np.savetxt(path, table, delimiter=",", header="t,pwm_left,pwm_right,phi_left_rad,phi_right_rad", comments="")
    (one,) = formats.read(path)
    assert one.channel("wheel_angle").values == pytest.approx(log[:, 6:8], abs=1e-6)


def test_a_share_of_what_motors_can_do_is_no_speed_whatever_its_numbers(tmp_path: Path) -> None:
    """PWM that happens to be what mm/s would be keeps its own scale; numbers of which no name speaks are mm/s."""
    log = drive(20.0, 0)
    for names, in_si in (("left_wheel,right_wheel", True), ("pwm_left,pwm_right", False)):
        (one,) = formats.read(
            written(tmp_path / "drive.csv", f"t,{names.replace(',', '_cmd,')}_cmd,x,y,theta", log, 1e3)
        )
        car, _ = with_commands(Vehicle("robot", TRACK, drive=TURNED, wheels=SIZES), [one])
        assert car.in_si is in_si


def test_a_calibrated_robot_refuses_wheels_that_are_told_in_another_unit(tmp_path: Path) -> None:
    plain, sized, *_ = (
        formats.read(written(tmp_path / f"drive_{k}.csv", names, drive(4.0, 0), factor))[0]
        for k, (names, factor) in enumerate(DIALECTS.items())
    )
    for full, one in (((1.0, 1.0), plain), ((1.0 / RADIUS, TRACK / RADIUS), sized)):
        with pytest.raises(RecordingError, match="say the unit"):
            VehicleSimulator(Vehicle("robot", TRACK, drive=TURNED, wheels=SIZES, full=full)).prepared(one)


def test_a_larger_wheel_turns_a_robot_with_the_way_it_drives() -> None:
    """Half as fast and backwards too: the turn of a metre is the same, to the other side backwards."""
    for speed in (0.2, 0.4, -0.4):
        t = np.arange(0.0, 8.0, 0.02)
        turned, still = 0.15 * speed * t, np.zeros((len(t), 1))
        way = np.cumsum(0.02 * speed * np.stack([np.cos(turned), np.sin(turned)], axis=1), axis=0)
        command = Channel("command", ("speed", "turn"), "", t, np.hstack([still + speed, still]), ("m/s", "rad/s"))
        place, angle = (
            Channel("position", ("x", "y"), "m", t, way),
            Channel("heading", ("heading",), "rad", t, turned[:, None]),
        )
        log = Recording("log", {c.name: c for c in (command, place, angle)})
        rolls = {"trim_lasts": 0.0, "push_lasts": 0.0}
        errors = [
            prediction_errors(robot, np.zeros(0), robot.prepared(log))[:, 1].max()
            for veer in (0.0, 0.15)
            if (robot := VehicleSimulator(Vehicle("robot", TRACK, values={"veer": veer, **rolls}, drive=TURNED)))
        ]
        assert errors[1] < 0.01
        assert errors[1] < 0.3 * errors[0]


def test_robots_that_are_never_fast_are_judged_while_they_drive(tmp_path: Path) -> None:
    slow = drive(20.0, 2)
    slow[:, 1:5] *= 0.2
    (one,) = formats.read(written(tmp_path / "drive.csv", "t,cmd_left_mps,cmd_right_mps,x,y,theta", slow))
    robot = VehicleSimulator(Vehicle("robot", TRACK, drive=TURNED, wheels=SIZES))
    assert len(prediction_errors(robot, np.zeros(0), robot.prepared(one))) > 20


def test_shares_of_a_motors_full_command_keep_a_scale_that_calibration_finds(tmp_path: Path) -> None:
    (one,) = formats.read(
        written(tmp_path / "drive.csv", "t,pwm_left,pwm_right,x,y,theta", drive(20.0, 0), 255.0 / 0.77)
    )
    car, notes = with_commands(Vehicle("robot", TRACK, drive=TURNED, wheels=Wheels(TRACK)), [one])
    assert not car.in_si
    assert "counts as the full command" in " ".join(notes)
    assert np.abs(VehicleSimulator(car).prepared(one).channel("command").values).max() <= 1.0


def test_a_wheel_that_counts_backwards_is_turned_round(tmp_path: Path) -> None:
    log = drive(20.0, 0)
    for name, middle, full in (("servo_left_us,servo_right_us", 1500.0, 400.0), ("wheel_l_cmd,wheel_r_cmd", 0.0, 1.0)):
        told = np.array(log)
        told[:, 1:3] = middle + full * log[:, 1:3] * [1, -1]
        (one,) = formats.read(written(tmp_path / "drive.csv", f"t,{name},x,y,theta", told))
        assert "counts backwards" in one.provenance["guesses"]
        command = one.channel("command").values
        assert command[:, 1] / log[:, 2] == pytest.approx(command[:, 0] / log[:, 1], rel=1e-4)
        assert np.all(command > 0.0)


def test_counts_that_add_up_and_begin_anew_are_a_place(tmp_path: Path) -> None:
    log = drive(20.0, 1)
    counts = np.floor(log[:, 6:8] * COUNTS / (2.0 * math.pi) + 60000.0) % 65536.0
    names = "time_ms,target_l_mps,target_r_mps,ticks_l,ticks_r"
    table = np.column_stack([1e3 * log[:, 0], log[:, 1:3], counts])
    np.savetxt(tmp_path / "drive.csv", table, delimiter=",", header=names, comments="", fmt="%.7f")
    (one,) = formats.read(tmp_path / "drive.csv")
    true = Wheels(TRUE_TRACK, TRUE_RADIUS, COUNTS)
    place = VehicleSimulator(Vehicle("robot", TRACK, drive=TURNED, wheels=true)).prepared(one).channel("position")
    assert place.values[-1] == pytest.approx(log[-1, 3:5], abs=0.02)
    with pytest.raises(RecordingError, match=r"add wheel_radius \(m\) and counts_per_turn"):
        as_driven(one, Wheels(TRACK))


def test_a_counter_begins_anew_where_it_jumps_by_all_its_bits() -> None:
    counted = np.arange(0.0, 2e5, 900.0)
    assert unwrapped(counted % 65536.0) == pytest.approx(counted)
    assert unwrapped((counted + 32768.0) % 65536.0 - 32768.0) == pytest.approx(counted)
    assert unwrapped(counted) == pytest.approx(counted)


def test_a_robots_file_is_found_from_its_wheels_and_replays_new_logs(tmp_path: Path) -> None:
    (tmp_path / "robot.toml").write_text(SAID)
    name = next(iter(DIALECTS))
    logs = [str(written(tmp_path / f"d{k}.csv", name, drive(9.0, k), DIALECTS[name])) for k in range(3)]
    fit = str(tmp_path / "fit")
    assert main(["calibrate", str(tmp_path / "robot.toml"), *logs[:2], "--out", fit, "-q"]) == 0
    assert "two driven wheels" in (tmp_path / "fit" / "report.html").read_text(encoding="utf-8")
    robot = read_vehicle(f"{fit}/robot.toml")
    assert robot.wheels == SIZES
    assert robot.values["speed_scale"] == pytest.approx(TRUE_RADIUS / RADIUS, rel=0.02)
    turn = 0.5 * (robot.values["turn_left"] + robot.values["turn_right"])
    assert TRACK * robot.values["speed_scale"] / turn == pytest.approx(TRUE_TRACK, rel=0.03)
    assert main(["replay", f"{fit}/robot.toml", logs[2], "-q"]) == 0
    simulator, new = VehicleSimulator(robot), formats.read(logs[2])[0]
    assert prediction_errors(simulator, np.zeros(0), simulator.prepared(new)).mean(axis=0)[1] < 0.04


def test_what_a_robots_file_lacks_is_said(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    (one,) = formats.read(written(tmp_path / "drive.csv", next(iter(DIALECTS)), drive(4.0, 0)))
    with pytest.raises(RecordingError, match=r"\[vehicle\] track = 0.23"):
        driven_by(one)
    for text, wrong in (
        ("", "'wheelbase' is missing .* or 'track'"),
        ("track = 0.2\nwheelbase = 0.3", "keep one of them"),
        ("track = 0.2\ndrive = 'throttle'", "keep one of them"),
        ("wheelbase = 0.2\nwheel_radius = 0.03", "add their 'track'"),
    ):
        path.write_text("[vehicle]\n" + text)
        with pytest.raises(ModelError, match=wrong):
            read_vehicle(path)
    turning: Recording = formats.read(
        written(tmp_path / "told.csv", "t,left_wheel_rpm_cmd,right_wheel_rpm_cmd,x,y,theta", drive(4.0, 0))
    )[0]
    with pytest.raises(RecordingError, match=r"add wheel_radius \(m\) to \[vehicle\]"):
        as_driven(turning, Wheels(TRACK))


def test_a_written_file_says_what_was_read(tmp_path: Path) -> None:
    (tmp_path / "robot.toml").write_text(SAID)
    robot = read_vehicle(tmp_path / "robot.toml")
    write_vehicle(robot, tmp_path / "again.toml")
    again = read_vehicle(tmp_path / "again.toml")
    assert (again.wheels, again.drive, again.wheelbase) == (SIZES, TURNED, TRACK)


def test_a_share_below_which_motors_stand_still_is_found(tmp_path: Path) -> None:
    lasting = "[vehicle.values]\npush_lasts = 0.0\ntrim_lasts = 0.0\nspeed_kept = 1.0\n"  # told: searched from once
    (tmp_path / "robot.toml").write_text(SAID + lasting)
    logs = []
    for seed in range(2):
        table = drive(15.0, seed, dead=0.16)
        table[:, 1:3] *= 255.0 / 0.8
        logs.append(formats.read(written(tmp_path / f"run_{seed}.csv", "t,pwm_left,pwm_right,x,y,theta", table))[0])
    ready = prepare(tmp_path / "robot.toml", logs)
    assert isinstance(ready.simulator, VehicleSimulator)
    full = ready.simulator.vehicle.full
    assert full is not None
    found = ready.calibrate(Options(stages=DESCENT, cross_validate=False, lacking=False))
    dead = next(e.value for e in found.estimates if e.name == "wheel_dead")
    assert dead == pytest.approx(0.16 / 0.8 * 255.0 / full[0], rel=0.15)
    ready.write(found, tmp_path / "found.toml", tmp_path / "parameters.toml")  # what is handed over predicts the same
    unseen = ready.simulator.prepared(logs[0])
    again = VehicleSimulator(read_vehicle(tmp_path / "found.toml"))
    assert prediction_errors(again, np.zeros(0), again.prepared(logs[0])) == pytest.approx(
        prediction_errors(ready.simulator, found.values, unseen)
    )


def test_a_dead_zone_is_refused_where_wheels_are_not_told_shares() -> None:
    with pytest.raises(ParameterError, match="wheel_dead is a share of what a left and a right wheel are told"):
        Vehicle("robot", TRACK, drive=TURNED, wheels=SIZES, values={"wheel_dead": 0.1})
    assert Vehicle(
        "robot", TRACK, drive=TURNED, wheels=SIZES, full=(500.0, -500.0), values={"wheel_dead": 0.1}
    ).told_shares


@pytest.mark.parametrize(
    ("drive", "in_si", "says"),
    [
        (TURNED, True, "speed in m/s and turn rate in rad/s, of two driven wheels"),
        (TURNED, False, "mean and difference of what a left and a right wheel are told, as shares of the full command"),
        (PURSUED, True, "speed in m/s and steering in rad"),
        (PURSUED, False, "speed and steering as in the logs, beyond middle and over full"),
    ],
)
def test_a_written_file_says_in_which_units_the_vehicle_is_commanded(
    drive: str, in_si: bool, says: str, tmp_path: Path
) -> None:
    """A robot that cmd_vel drives was said to be told shares by two wheels, a tractor's percent of steering to be rad."""
    sizes = SIZES if drive == TURNED else None
    robot = Vehicle("robot", TRACK, drive=drive, wheels=sizes, full=(1.0, 1.0), in_si=in_si)
    write_vehicle(robot, tmp_path / "robot.toml")
    assert f"# commands: {says}\n" in (tmp_path / "robot.toml").read_text(encoding="utf-8")


def test_three_wheels_that_are_told_one_by_one_are_said_to_drive_sideways() -> None:
    time = np.linspace(0.0, 5.0, 101)
    told = np.stack([np.sin(time), np.cos(time), np.sin(2.0 * time)], axis=1)
    log = Recording("omni", {"command": Channel("command", ("w1", "w2", "w3"), "rad/s", time, told)})
    with pytest.raises(RecordingError, match=r"found: w1, w2, w3.*three omni wheels.* is not simulated"):
        driven_by(log)
