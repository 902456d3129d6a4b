# SPDX-License-Identifier: Apache-2.0
"""Feet that stand still tell where a base was that nobody tracked, and which legs were mixed up in a log."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.articulated.attitude import attitude, by_tilt, smoothed_attitude
from trueup.articulated.pose import angles_of, turning, up_of
from trueup.discrepancies.weighted import Weighted
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.setup.footsteps import legs_of
from trueup.grounding.others import as_shown, others_of
from trueup.inspection.sliding import sliding
from trueup.loop.horizon import cut_for_search
from trueup.loop.prepare import Preparation, prepare
from trueup.loop.problem import Problem
from trueup.loop.replay import replays
from trueup.loop.start_errors import with_start_errors
from trueup.loop.windows import carried
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]

_LEG = '<body name="{0}" pos="{1} 0"><joint name="{0}_side" axis="1 0 0"/><joint name="{0}_hip" \
axis="0 1 0"/><geom type="capsule" size=".012" fromto="0 0 0 0 0 -.1" mass=".1"/><body \
pos="0 0 -.1"><joint name="{0}_knee" axis="0 1 0"/><geom type="capsule" size=".01" \
fromto="0 0 0 0 0 -.1" mass=".05"/></body></body>'
_PLACES = {"fl": ".12 .07", "fr": ".12 -.07", "rl": "-.12 .07", "rr": "-.12 -.07"}
_JOINTS = tuple(f"{leg}_{joint}" for leg in _PLACES for joint in ("side", "hip", "knee"))
_DOG = f"""<mujoco><default><joint damping=".3" armature=".004" frictionloss=".03"/></default>
<option timestep=".002" integrator="implicitfast"/><worldbody><geom type="plane" size="5 5 .1"/>
<body name="trunk" pos="0 0 .17"><freejoint name="root"/><site name="imu" quat="0 0 0 1"/><geom type="box"
size=".14 .05 .03" mass="1.5" />{"".join(_LEG.format(n, p) for n, p in _PLACES.items())}</body></worldbody><actuator>
{"".join(f'<position name="{j}" joint="{j}" kp="25"/>' for j in _JOINTS)}</actuator><sensor><gyro name="gyro" site="imu"/>
<accelerometer name="accelerometer" site="imu"/></sensor></mujoco>"""
_TURNING = ("gyro", "accelerometer")


def _trot(time: Array) -> Array:
    """(T, 12) commands: it stands on bent legs, sways, then trots."""
    share = np.clip(time - 1.7, 0.0, 1.0)
    phases = 2.0 * np.pi * (2.0 * time[:, None] + [0.0, 0.5, 0.5, 0.0])
    sway = 0.12 * np.sin(6.0 * np.clip(time - 0.3, 0.0, np.pi / 3.0))
    side = np.repeat(sway[:, None], 4, axis=1)
    lifted = 0.5 * np.clip(np.sin(phases), 0.0, None) * share[:, None]
    hip = 0.7 + 0.15 * share[:, None] * np.cos(phases) + 0.5 * lifted
    return np.stack([side, hip, -1.4 - lifted], axis=2).reshape(len(time), 12)


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Recording]:
    """A quadruped that trots, all of it recorded with noise at 100 Hz, and its file."""
    path = tmp_path_factory.mktemp("dog") / "dog.xml"
    path.write_text(_DOG)
    model = mujoco.MjModel.from_xml_string(_DOG)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    time, rows = np.arange(0.0, 3.4, 0.01), []
    commands = _trot(time)
    data.qpos[7:] = data.ctrl[:] = commands[0]
    mujoco.mj_step(model, data, 500)
    for command in commands:
        data.ctrl[:] = command
        rows.append(np.concatenate([data.qpos[7:], data.qpos[:7], data.sensordata]))
        mujoco.mj_step(model, data, 5)
    seen = np.array(rows) + rng.normal(0.0, 1.0, (len(time), 25)) * np.repeat([5e-4, 5e-4, 0.01, 0.1], [12, 7, 3, 3])
    channels = (
        Channel("command", _JOINTS, "rad", time, commands),
        Channel("position", _JOINTS, "rad", time, seen[:, :12]),
        Channel("base_position", ("x", "y", "z"), "m", time, seen[:, 12:15]),
        Channel("base_orientation", ("w", "x", "y", "z"), "", time, seen[:, 15:19]),
        Channel("gyro", ("x", "y", "z"), "rad/s", time, seen[:, 19:22]),
        Channel("accelerometer", ("x", "y", "z"), "m/s^2", time, seen[:, 22:]),
    )
    return path, Recording("trot", {c.name: c for c in channels})


def _blind(walked: tuple[Path, Recording], without: Sequence[str], refuse: Sequence[str] = ()) -> Preparation:
    path, recording = walked
    for name in without:
        recording = recording.without(name)
    return prepare(path, [recording], propose=False, refuse=refuse)


@pytest.mark.parametrize("unseen", [_TURNING, ("base_orientation",)])
def test_where_the_base_was_is_told_by_its_feet(walked: tuple[Path, Recording], unseen: tuple[str, ...]) -> None:
    _, recording = walked
    ready = _blind(walked, ("base_position", *unseen))
    (found,) = ready.recordings
    truth = recording.channel("base_position").values
    place = found.channel("base_position").values + truth[0] * [1.0, 1.0, 0.0]
    went = float(np.linalg.norm(truth[-1, :2] - truth[0, :2]))
    assert went > 0.05
    assert np.linalg.norm(place[-1] - truth[-1]) < 0.2 * went  # feet slip a little
    assert np.sqrt(np.mean((place[:, 2] - truth[:, 2]) ** 2)) < 3e-3
    angles = angles_of(recording.channel("base_orientation").values)
    assert np.sqrt(np.mean((found.channel("base_orientation").values - angles)[:, :2] ** 2)) < 0.02
    assert any("its pose is reckoned from" in str(n) for n in ready.notes)
    assert not any("held in the air" in str(n) for n in ready.notes)


def test_roll_and_pitch_alone_tell_where_the_base_was_and_are_compared(walked: tuple[Path, Recording]) -> None:
    path, recording = walked
    turned = recording.channel("base_orientation")
    tilt = Channel("imu", ("roll", "pitch"), "rad", turned.time, angles_of(turned.values)[:, :2])
    for name in ("base_position", "base_orientation", *_TURNING):
        recording = recording.without(name)
    ready = prepare(path, [recording.with_channel(tilt)], propose=False)
    (found,) = ready.recordings
    truth = walked[1].channel("base_position").values
    assert np.sqrt(np.mean((found.channel("base_position").values[:, 2] - truth[:, 2]) ** 2)) < 3e-3
    assert any("'imu'" in str(n) and "taken not to change" in str(n) for n in ready.notes)
    assert set(ready.simulator.observable(found)) == {"position", "base_orientation"}
    assert not ready.unused()  # under another name
    problem = with_start_errors(Problem(ready.simulator, ready.recordings, Weighted({})), np.zeros(0))
    assert set(problem.trials[0].initial_sd) == {"base_position"}
    (whole,) = replays(ready.simulator, np.zeros(0), (), [found], channels=["position"], windows=np.inf)
    hanging = _blind(walked, ("base_position", "base_orientation"), ["feet"])
    (other,) = replays(hanging.simulator, np.zeros(0), (), hanging.recordings, channels=["position"], windows=np.inf)
    assert _rms(whole.after - whole.measured) < 0.2 * _rms(other.after - other.measured)


def test_a_gyro_tells_the_heading_beside_roll_and_pitch(walked: tuple[Path, Recording]) -> None:
    _, recording = walked
    turned = recording.channel("base_orientation")
    angles = angles_of(turned.values)
    rates = turning(angles, np.gradient(angles, turned.time, axis=0))
    tilt = Channel("imu", ("roll", "pitch"), "rad", turned.time, angles[:, :2])
    logged = Recording("trot", {"imu": tilt, "gyro": Channel("gyro", ("x", "y", "z"), "rad/s", turned.time, rates)})
    assert attitude(logged) is None
    found = by_tilt(logged)
    assert found is not None
    assert found[1] == ("'imu'", "'gyro'")
    assert _rms(found[0].values[:, 2] - (angles[:, 2] - angles[0, 2])) < 0.02


def _rms(errors: Array) -> float:
    return float(np.sqrt(np.nanmean(errors**2)))


def test_positions_that_are_a_whole_state_are_parted_into_the_base_and_joints(walked: tuple[Path, Recording]) -> None:
    path, recording = walked
    place, turn, position = (recording.channel(n) for n in ("base_position", "base_orientation", "position"))
    labels = tuple(f"joint_{k}" for k in range(19))
    state = position.replace(labels=labels, values=np.hstack([place.values, turn.values, position.values]))
    speeds = Channel("velocity", labels[:18], "", place.time, np.gradient(state.values[:, 1:], place.time, axis=0))
    logged = recording.without("base_position").without("base_orientation").with_channel(state).with_channel(speeds)
    (found,) = prepare(path, [logged], propose=False).recordings
    np.testing.assert_allclose(found.channel("position").select(_JOINTS).values, position.select(_JOINTS).values)
    np.testing.assert_allclose(found.channel("base_position").values, place.values)
    assert found.channel("velocity").labels == found.channel("position").labels


def test_the_robot_replays_from_there_and_is_not_compared_with_what_was_reckoned(
    walked: tuple[Path, Recording],
) -> None:
    ready = _blind(walked, ("base_position", "base_orientation"))
    assert set(ready.simulator.observable(ready.recordings[0])) == {"position", *_TURNING}
    assert not ready.unused()
    (shown,), _ = as_shown(
        ready.recordings, ready.simulator
    )  # a grounding does not learn from it, and begins there, too
    assert set(others_of([shown])) == set(_TURNING)
    assert shown.has("base_position")
    hanging = _blind(walked, ("base_position", "base_orientation"), ["feet"])
    rest = []
    for own in (ready, hanging):
        values = own.simulator.parameters.nominal
        (whole,) = replays(own.simulator, values, (), own.recordings, channels=["position"], windows=np.inf)
        rest.append(np.sqrt(np.nanmean((whole.after - whole.measured) ** 2)))
    assert rest[0] < 0.2 * rest[1]


@pytest.mark.parametrize("unseen", [_TURNING, ("base_orientation",)])
def test_where_a_log_begins_in_the_middle_of_a_walk_short_replays_tell_that_it_was_on_its_feet(
    walked: tuple[Path, Recording], unseen: tuple[str, ...]
) -> None:
    path, recording = walked
    blind = recording.slice(2.05, 3.4)
    truth = angles_of(blind.channel("base_orientation").values)
    for name in ("base_position", *unseen):
        blind = blind.without(name)
    ready = prepare(path, [blind], propose=False)
    (found,) = ready.recordings
    assert found.has("base_position")
    assert any("% of the way" in str(n) for n in ready.notes)
    assert np.sqrt(np.mean((found.channel("base_orientation").values - truth)[:, :2] ** 2)) < 0.03


def _by_torques(walked: tuple[Path, Recording], folder: Path, *, propose: bool = False) -> Preparation:
    """Of the walk, as if it had been told the torques of its servos."""
    _, recording = walked
    (folder / "dog.xml").write_text(_DOG.replace("<position", "<motor").replace(' kp="25"', ""))
    command, position = recording.channel("command"), recording.channel("position")
    torque = 25.0 * (command.values - position.values)
    told = Channel("command_torque", position.labels, "N m", position.time, torque)
    blind = recording.without("base_position").without("command").with_channel(told)
    return prepare(folder / "dog.xml", [blind], propose=propose)


def test_a_robot_that_is_told_torques_is_known_to_walk_by_short_replays(
    walked: tuple[Path, Recording], tmp_path: Path
) -> None:
    ready = _by_torques(walked, tmp_path)
    assert ready.recordings[0].has("base_position")
    assert any("% of the way" in str(n) for n in ready.notes)


def test_starts_of_a_robot_that_is_told_torques_are_as_low_as_its_feet_sink_in(
    walked: tuple[Path, Recording], tmp_path: Path
) -> None:
    _, recording = walked
    ready = _by_torques(walked, tmp_path)
    problem = Problem(
        ready.simulator, ready.recordings, Weighted.estimated(ready.recordings, ("position",)), ("position",)
    )
    (trial,) = with_start_errors(problem, ready.simulator.parameters.nominal).trials
    truth = recording.channel("base_position").values[:, 2]
    as_reckoned, begun = (c.values[:, 2] - truth for c in (ready.recordings[0].channel("base_position"),
                                                          trial.initial["base_position"]))  # fmt: skip
    assert abs(np.median(begun)) < 0.5 * abs(np.median(as_reckoned))
    assert 0.0 < trial.initial_sd["base_position"][0, 2] < 1e-3


def test_windows_of_torques_from_reckoned_starts_are_as_long_as_replays_are_smooth_and_their_starts_are_free(
    walked: tuple[Path, Recording], tmp_path: Path
) -> None:
    ready = _by_torques(walked, tmp_path, propose=True)
    space = ready.simulator.parameters
    problem = Problem(
        ready.simulator, ready.recordings, Weighted.estimated(ready.recordings, ("position",)), ("position",)
    )
    begun, _, lasting, words = cut_for_search(problem, space.nominal, space, np.inf, 0)
    assert begun.windowed
    assert len(begun.eliminated) == len(begun.trials)
    assert begun.trials[0].duration == pytest.approx(lasting, rel=0.5)
    assert "bend too much" in words[0]
    assert "times the noise" not in words[0]


def test_it_is_known_how_far_off_is_what_was_reckoned(walked: tuple[Path, Recording]) -> None:
    _, recording = walked
    ready = _blind(walked, ("base_position", "base_orientation"))
    channels = ("position", *_TURNING)
    problem = Problem(ready.simulator, ready.recordings, Weighted.estimated(ready.recordings, channels), channels)
    (trial,) = with_start_errors(problem, ready.simulator.parameters.nominal).trials
    (found,) = ready.recordings
    off = found.channel("base_position").values[:, 2] - recording.channel("base_position").values[:, 2]
    tilt = angles_of(recording.channel("base_orientation").values)[:, :2]
    wrong = found.channel("base_orientation").values[:, :2] - tilt
    for name, sd, error in (("height", trial.initial_sd["base_position"][0, 2], off),
                            ("tilt", trial.initial_sd["base_orientation"][0, :2].mean(), wrong)):  # fmt: skip
        assert 0.3 < sd / np.sqrt(np.mean(error**2)) < 3.0, name
    assert carried(with_start_errors(problem, ready.simulator.parameters.nominal))


def test_a_gyro_that_drifts_is_drawn_to_what_is_up_before_and_after(walked: tuple[Path, Recording]) -> None:
    _, recording = walked
    time, mount = recording.channel("gyro").time, [-1.0, -1.0, 1.0]  # the unit is turned by half a turn
    rates, pulls = (recording.channel(name).values * mount for name in _TURNING)
    truth = angles_of(recording.channel("base_orientation").values)
    for drift in ([0.0, 0.0, 0.0], [0.05, -0.03, 0.0]):
        angles, changes = smoothed_attitude(time, rates + drift, pulls)
        assert np.sqrt(np.mean((angles - truth)[:, :2] ** 2)) < 0.012
        assert np.abs(angles[0, :2] - truth[0, :2]).max() < 4e-3
        np.testing.assert_allclose(turning(angles, changes)[:, :2].mean(axis=0), rates[:, :2].mean(axis=0), atol=0.02)


def test_the_direction_of_gravity_and_a_gyro_tell_how_the_base_was_turned(walked: tuple[Path, Recording]) -> None:
    path, recording = walked
    turn = recording.channel("base_orientation")
    gyro = Channel("base_ang_vel", ("x", "y", "z"), "", turn.time, recording.channel("gyro").values * [-1.0, -1.0, 1.0])
    down = Channel("projected_gravity", ("x", "y", "z"), "", turn.time, -up_of(turn.values))
    blind = recording.without("base_position").without("base_orientation").without("gyro").without("accelerometer")
    (found,) = prepare(path, [blind.with_channel(gyro).with_channel(down)], propose=False).recordings
    angles = angles_of(turn.values)
    off = found.channel("base_orientation").values - angles
    assert np.abs(off[:, :2]).max() < 1e-3
    assert np.abs(off[:, 2] - off[0, 2]).max() < 0.01


def test_a_robot_that_hangs_is_held_as_before(tmp_path: Path) -> None:
    (tmp_path / "dog.xml").write_text(_DOG)
    time = np.arange(0.0, 3.0, 0.01)
    hung = {
        "command": Channel("command", _JOINTS, "rad", time, _trot(time)),
        "position": Channel("position", _JOINTS, "rad", time, _trot(time)),
        "base_orientation": Channel("base_orientation", ("w", "x", "y", "z"), "", time, np.eye(4)[[0] * len(time)]),
    }
    for hangs in (Recording("hung", hung), Recording("hung", hung).slice(1.9, 3.0)):  # from rest, and not
        notes = prepare(tmp_path / "dog.xml", [hangs], propose=False).notes
        assert any("it is held in the air" in str(n) for n in notes)


def test_legs_and_joints_that_were_mixed_up_are_named(walked: tuple[Path, Recording]) -> None:
    path, recording = walked
    assert not sliding(legs_of(load(path)), [recording])
    other = {"fl": "fr", "fr": "fl", "rl": "rr", "rr": "rl"}
    swapped = recording.rename({j: other[j[:2]] + j[2:] for j in _JOINTS})
    (said,) = sliding(legs_of(load(path)), [swapped.slice(1.7, 3.4)])
    assert "left and right are exchanged" in said
    position = recording.channel("position")
    signs = np.where(np.array(_JOINTS) == "rr_side", -1.0, 1.0)
    (said,) = sliding(
        legs_of(load(path)), [recording.with_channel(position.replace(values=position.values * signs)).slice(0.0, 1.5)]
    )
    assert "'rr_side' turns the other way" in said


def test_a_robot_on_a_treadmill_is_told_of(walked: tuple[Path, Recording]) -> None:
    path, recording = walked
    walking = recording.slice(2.2, 3.4)
    place = walking.channel("base_position")
    speed = (place.values[-1] - place.values[0]) / (place.time[-1] - place.time[0])
    belt = place.replace(values=place.values - (place.time - place.time[0])[:, None] * speed * [1.0, 1.0, 0.0])
    (said,) = sliding(legs_of(load(path)), [walking.with_channel(belt)])
    assert "treadmill" in said
    told = float(said.split("about ")[1].split(" m/s")[0])
    assert told == pytest.approx(np.hypot(*speed[:2]), rel=0.3)  # feet slip a little


@pytest.mark.parametrize("way", ["imu", "imu_quat", "orientation", "q", "imu_rpy"])
def test_an_attitude_under_the_name_of_an_inertial_unit_tells_how_the_base_was_turned(
    walked: tuple[Path, Recording], way: str
) -> None:
    path, recording = walked
    turn = recording.channel("base_orientation")
    blind = recording.without("base_position").without("base_orientation").without("gyro").without("accelerometer")
    if way == "q":  # columns qw, qx, qy, qz
        for label in turn.labels:
            blind = blind.with_channel(Channel(f"q{label}", (f"q{label}",), "", turn.time, turn.column(label)[:, None]))
    elif way == "imu_rpy":
        angles = np.degrees(angles_of(turn.values))
        blind = blind.with_channel(Channel(way, ("roll", "pitch", "yaw"), "deg", turn.time, angles))
    else:
        labels = ("qw", "qx", "qy", "qz") if way == "imu" else turn.labels
        blind = blind.with_channel(turn.replace(name=way, labels=labels))
    (expected,) = _blind(walked, ("base_position", *_TURNING)).recordings
    (found,) = prepare(path, [blind], propose=False).recordings
    assert "base_orientation" in prepare(path, [blind], propose=False).simulator.observable(found)  # and is compared
    for name in ("base_position", "base_orientation"):
        np.testing.assert_allclose(found.channel(name).values, expected.channel(name).values, atol=1e-4)
    foot = blind.replace(channels={n: c for n, c in blind.channels.items() if n in ("command", "position")})
    foot = foot.with_channel(turn.replace(name="foot_quat"))
    assert any("it is held in the air" in str(n) for n in prepare(path, [foot], propose=False).notes)
