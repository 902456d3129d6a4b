# SPDX-License-Identifier: Apache-2.0
"""A free base starts where it was measured to be, its pose is compared, and what it carries is found."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.articulated.declarations import Declaration, declare
from trueup.articulated.pose import angles_of, near, product, quaternion_of, turning, up_of
from trueup.engines.mujoco.base import check_base
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.mujoco.setup.drives import suited
from trueup.engines.mujoco.writing.write import write_model
from trueup.errors import ModelError
from trueup.loop.ahead import predicted_ahead
from trueup.loop.calibrate import Options, calibrate
from trueup.loop.fit import DESCENT
from trueup.loop.prepare import prepare, simulator_for
from trueup.loop.replay import replays
from trueup.recording import Channel, Recording
from trueup.trial import Trial

Array = NDArray[np.float64]

_LEG = '<body name="{0}" pos="{1} 0"><joint name="{0}_hip" axis="0 1 0" damping=".1"/><geom type="capsule" size=".02" \
fromto="0 0 0 .08 0 -.12" mass=".15"/><body pos=".08 0 -.12"><joint name="{0}_knee" axis="0 1 0" damping=".1"/>\
<geom type="capsule" size=".02" fromto="0 0 0 -.08 0 -.12" mass=".1"/></body></body>'
_LEGS = "".join(
    _LEG.format(n, p) for n, p in (("fl", ".15 .1"), ("fr", ".15 -.1"), ("rl", "-.15 .1"), ("rr", "-.15 -.1"))
)
_JOINTS = tuple(f"{leg}_{joint}" for leg in ("fl", "fr", "rl", "rr") for joint in ("hip", "knee"))
_DRIVES = "".join(f'<position name="{j}" joint="{j}" kp="{{kp}}" kv=".4"/>' for j in _JOINTS)
_DOG = f"""<mujoco><option timestep=".002" integrator="implicitfast"/><worldbody><geom type="plane" size="5 5 .1"/>
<body name="trunk" pos="0 0 .3"><freejoint name="root"/><geom type="box" size=".2 .08 .04" mass="{{mass}}" contype="0"
conaffinity="0"/>{_LEGS}</body></worldbody><actuator>{_DRIVES}</actuator></mujoco>"""


def _squats(mass: float = 4.0, kp: float = 40.0) -> Recording:
    """A small quadruped that squats and rolls, tracked by motion capture at 100 Hz; its pose with noise."""
    model = mujoco.MjModel.from_xml_string(_DOG.format(mass=mass, kp=kp))
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    mujoco.mj_step(model, data, 700)
    rows, time = [], np.arange(0.0, 2.0, 0.01)
    for t in time:
        bend = 0.25 * (1.0 - np.cos(5.0 * t)) + 0.1 * np.repeat([1, -1, 1, -1], 2) * np.sin(8.0 * t) * min(1.0, t)
        data.ctrl[:] = np.tile([0.6, -1.0], 4) * bend
        rows.append(np.concatenate([data.ctrl, data.qpos[7:], data.qpos[:7]]))
        mujoco.mj_step(model, data, 5)
    values = np.array(rows)
    values[:, 8:] += rng.normal(0.0, 3e-4, values[:, 8:].shape)
    channels = (
        Channel("command", _JOINTS, "rad", time, values[:, :8]),
        Channel("position", _JOINTS, "rad", time, values[:, 8:16]),
        Channel("base_position", ("x", "y", "z"), "m", time, values[:, 16:19]),
        Channel("base_orientation", ("w", "x", "y", "z"), "", time, values[:, 19:]),
    )
    return Recording("squats", {c.name: c for c in channels})


def _written(folder: Path, text: str = _DOG.format(mass=4.0, kp=40.0)) -> Path:
    (folder / "dog.xml").write_text(text)
    return folder / "dog.xml"


def _taken(path: Path, recording: Recording) -> tuple[list[Recording], list[str]]:
    ready = prepare(path, [recording], propose=False)
    return list(ready.recordings), list(ready.notes)


def test_angles_are_those_of_the_quaternion_and_rates_turn_it() -> None:
    rng = np.random.default_rng(1)
    for angles in rng.uniform(-1.4, 1.4, (20, 3)):
        np.testing.assert_allclose(angles_of(quaternion_of(angles)), angles, atol=1e-12)
        rates, h = rng.normal(0.0, 1.0, 3), 1e-6
        spin, ahead = np.zeros(3), quaternion_of(angles + h * rates)
        mujoco.mju_subQuat(spin, ahead, quaternion_of(angles))
        np.testing.assert_allclose(turning(angles, rates), spin / h, atol=1e-5)
        turned, matrix = np.zeros(4), np.zeros(9)
        mujoco.mju_mulQuat(turned, ahead, quaternion_of(rates))
        mujoco.mju_quat2Mat(matrix, ahead)
        np.testing.assert_allclose(product(ahead, quaternion_of(rates)), turned, atol=1e-12)
        np.testing.assert_allclose(up_of(ahead), matrix[6:], atol=1e-12)
    turns = near(np.array([[[0.1, 0.0, -3.1]]]), np.array([[0.1, np.nan, 3.15]]))
    np.testing.assert_allclose(turns[0, 0], [0.1, 0.0, 2.0 * np.pi - 3.1])


def test_the_robot_that_was_recorded_replays_its_pose(tmp_path: Path) -> None:
    recordings, _ = _taken(_written(tmp_path), _squats())
    simulator, _ = simulator_for(tmp_path / "dog.xml", recordings)
    shipped = simulator.shipped()
    (run,) = shipped.rollout([Trial.of(recordings[0])], np.zeros((1, 0)))
    for name, limit in (("base_position", 2e-3), ("base_orientation", 1e-2)):
        error = run.channels[name][0] - recordings[0].channel(name).values
        assert np.sqrt(np.mean(error**2)) < limit
    assert "trunk.mass" in simulator.parameters.names


def test_what_the_trunk_carries_is_found_from_its_pose(tmp_path: Path) -> None:
    recordings, _ = _taken(_written(tmp_path), _squats(mass=5.0, kp=48.0))
    model = load(tmp_path / "dog.xml")
    space, quantities = declare(
        model, [Declaration("kp", ("*",), tie="all", name="kp"), Declaration("mass", ("trunk",))]
    )
    found = calibrate(
        MujocoSimulator(model, space, quantities), recordings,
        options=Options(cross_validate=False, select=False, stages=DESCENT),
    )  # fmt: skip
    mass, kp = (next(e for e in found.estimates if e.name == name) for name in ("trunk.mass", "kp"))
    assert mass.low < 5.0 < mass.high
    assert mass.value == pytest.approx(5.0, rel=0.12)
    assert kp.value == pytest.approx(48.0, rel=0.05)


def test_how_far_the_trunk_s_mass_is_spread_is_asked_and_written(tmp_path: Path) -> None:
    recordings, _ = _taken(_written(tmp_path), _squats())
    proposed, _ = simulator_for(tmp_path / "dog.xml", recordings)
    spreads = {f"trunk.spread_{a}": half / np.sqrt(3.0) for a, half in zip("xyz", (0.2, 0.08, 0.04), strict=True)}
    at_first = dict(zip(proposed.parameters.names, proposed.parameters.nominal, strict=True))
    assert {n: at_first[n] for n in spreads} == pytest.approx(spreads)
    model = load(tmp_path / "dog.xml")
    lines = [Declaration(kind, ("trunk",)) for kind in ("mass", "spread_x", "spread_z")]
    write_model(MujocoSimulator(model, *declare(model, lines)), [6.0, 0.1, 0.05], tmp_path / "fit.xml")
    y = spreads["trunk.spread_y"]
    written = mujoco.MjModel.from_xml_path(str(tmp_path / "fit.xml")).body("trunk")
    ours = 6.0 * np.array([y**2 + 0.05**2, 0.1**2 + 0.05**2, 0.1**2 + y**2])
    assert [*written.mass, *sorted(written.inertia)] == pytest.approx([6.0, *sorted(ours)])


def test_a_base_that_one_recording_does_not_show_is_refused_or_starts_at_the_keyframe(tmp_path: Path) -> None:
    seen, blind = _squats(), _squats().without("base_position").replace(name="blind")
    path = _written(tmp_path)
    with pytest.raises(ModelError, match=r"base of model 'dog\.xml' is free, but nothing tells where it was in blind"):
        simulator_for(path, [seen, blind])
    key = '<keyframe><key qpos="0 0 .3 1 0 0 0 0 0 0 0 0 0 0 0"/></keyframe></mujoco>'
    _, notes = simulator_for(_written(tmp_path, path.read_text().replace("</mujoco>", key)), [seen, blind])
    assert any("starts as in the model's first keyframe" in note for note in notes)


def test_a_pose_in_the_plane_is_refused_with_what_completes_it(tmp_path: Path) -> None:
    seen = _squats()
    place, turn = seen.channel("base_position"), seen.channel("base_orientation")
    flat = seen.with_channel(place.select(("x", "y"))).with_channel(
        turn.replace(labels=("yaw",), unit="rad", values=turn.values[:, 3:])
    )
    with pytest.raises(
        ModelError, match=r"tells x, y of base_position and yaw of base_orientation; .* a floor that is level add"
    ):
        simulator_for(_written(tmp_path), [flat])


@pytest.mark.parametrize("keyframe", ["", '<keyframe><key qpos="0 0 .1 1 0 0 0 0 0 0 0 0 0 0 0"/></keyframe>'])
def test_a_dog_on_a_stand_is_replayed_by_its_free_model_though_nobody_saw_its_base(
    tmp_path: Path, keyframe: str
) -> None:
    """In the keyframe the feet are in the floor; on its stand, pitched by 0.2 rad, the dog touches nothing."""
    text = _DOG.format(mass=4.0, kp=40.0).replace("</mujoco>", f"{keyframe}</mujoco>")
    hung = text.replace('pos="0 0 .3"', 'pos="0 0 2" euler="0 11.459 0"').replace('<freejoint name="root"/>', "")
    truth = mujoco.MjModel.from_xml_string(hung.replace(keyframe, ""))
    data, time, rows = mujoco.MjData(truth), np.arange(0.0, 2.0, 0.01), []
    for t in time:
        rows.append((data.ctrl.copy(), data.qpos.copy()))
        data.ctrl[:] = 0.4 * np.sin(6.0 * t)
        mujoco.mj_step(truth, data, 5)
    told, seen = (np.array(column) for column in zip(*rows, strict=True))
    turned = np.tile([0.0, 0.2, 1.0], (len(time), 1))
    channels = (
        Channel("command", _JOINTS, "rad", time, np.roll(told, -1, axis=0)),
        Channel("position", _JOINTS, "rad", time, seen),
        Channel("base_orientation", ("roll", "pitch", "yaw"), "rad", time, turned),
    )
    log = Recording("stand", {c.name: c for c in channels})
    simulator, notes = simulator_for(_written(tmp_path, text), [log])
    assert any("held in the air, as it was turned" in note for note in notes)
    (run,) = simulator.shipped().rollout([Trial.of(log, ["position"])], np.zeros((1, 0)))
    assert np.std(run.channels["position"][0] - seen) < 2e-3


@pytest.mark.parametrize(("rate", "walked"), [(0.6, True), (0.01, False)])
def test_a_gyro_speaks_against_a_stand_that_nobody_said_was_there(tmp_path: Path, rate: float, walked: bool) -> None:
    time = np.arange(0.0, 3.0, 0.01)
    still = Channel("command", _JOINTS, "rad", time, np.zeros((len(time), len(_JOINTS))))
    rates = 0.03 + rate * np.sin(4.0 * time)[:, None] * (0.0, 1.0, 0.2)  # with a bias
    gyro = Channel("imu_gyro", ("x", "y", "z"), "rad/s", time, rates)
    log = Recording("walk", {c.name: c for c in (still, still.replace(name="position"), gyro)})
    _, notes = simulator_for(_written(tmp_path), [log])
    (note,) = (n for n in notes if "held in the air" in n)
    assert ("by 'imu_gyro' it turned by" in note) == walked


def test_quaternions_of_an_inertial_unit_speak_against_a_stand_too(tmp_path: Path) -> None:
    time = np.arange(0.0, 3.0, 0.01)
    still = Channel("command", _JOINTS, "rad", time, np.zeros((len(time), len(_JOINTS))))
    half = 0.05 * np.sin(4.0 * time)
    turn = np.stack([np.cos(half), 0.0 * time, np.sin(half), 0.0 * time], axis=1)
    unit = Channel("imu_quat", ("w", "x", "y", "z"), "", time, turn)
    log = Recording("walk", {c.name: c for c in (still, still.replace(name="position"), unit)})
    _, notes = simulator_for(_written(tmp_path), [log])
    assert any("It was not held: by 'imu_quat' it turned by" in note for note in notes)


def test_a_quaternion_under_another_name_is_offered_as_the_bases(tmp_path: Path) -> None:
    """Of columns mc_x_mm ... mc_qw ... nothing but "no recording tells where it was" was said."""
    time = np.arange(0.0, 1.0, 0.01)
    still = Channel("command", _JOINTS, "rad", time, np.zeros((len(time), len(_JOINTS))))
    upright = Channel("mc", ("qw", "qx", "qy", "qz"), "", time, np.tile([1.0, 0.0, 0.0, 0.0], (len(time), 1)))
    plain = {c.name: c for c in (still, still.replace(name="position"))}
    for channels, offered in (({**plain, "mc": upright}, True), (plain, False)):
        _, notes = simulator_for(_written(tmp_path), [Recording("walk", channels)])
        (note,) = (n for n in notes if "held in the air" in n)
        assert ("If 'mc' is the base's, call it [channels.base_orientation]" in note) == offered


@pytest.mark.parametrize(("stands", "pace"), [(True, 0.0), (True, 0.5), (False, 0.0)])
def test_joints_that_rest_as_under_the_robots_weight_speak_against_a_stand(
    tmp_path: Path, stands: bool, pace: float
) -> None:
    """Of a dog heavier and softer than its model, begun in a posture that its keyframe has not; commands of some `pace`
    (rad/s) set out at once.
    """
    told = np.tile([0.3, -0.5], 4)
    text = _DOG.format(mass=4.8, kp=35.0)
    if not stands:
        text = text.replace('pos="0 0 .3"', 'pos="0 0 2"').replace('<freejoint name="root"/>', "")
    model = mujoco.MjModel.from_xml_string(text)
    data, time = mujoco.MjData(model), np.arange(0.0, 1.0, 0.01)
    data.ctrl[:] = told
    mujoco.mj_step(model, data, 1000)
    seen = data.qpos[-len(_JOINTS) :] + np.random.default_rng(0).normal(0.0, 5e-4, (len(time), len(_JOINTS)))
    channels = (
        Channel("command", _JOINTS, "rad", time, told + pace * time[:, None]),
        Channel("position", _JOINTS, "rad", time, seen),
    )
    _, notes = simulator_for(_written(tmp_path), [Recording("rest", {c.name: c for c in channels})])
    (note,) = (n for n in notes if "held in the air" in n)
    assert ("as where the model stands on the floor" in note) == stands


def test_a_robot_on_its_feet_is_not_said_to_work_above_a_table(tmp_path: Path) -> None:
    """It was held because its pose was not logged; that it sags on its feet is no table in its way."""
    time = np.arange(0.0, 2.0, 0.01)
    channels = (
        Channel("command", _JOINTS, "rad", time, np.tile([0.3, -0.5], (len(time), 4))),
        Channel("position", _JOINTS, "rad", time, np.tile([0.6, -0.4], (len(time), 4))),
    )
    _, notes = simulator_for(_written(tmp_path), [Recording("stands", {c.name: c for c in channels})])
    assert any("held in the air" in note for note in notes)
    assert not any("has no floor" in note for note in notes)


def test_a_urdf_whose_base_was_seen_to_move_is_set_free(tmp_path: Path) -> None:
    inertial = (
        '<inertial><mass value="{0}"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    ball = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'
    (tmp_path / "ball.urdf").write_text(
        f'<robot name="b"><link name="trunk">{inertial.format(2)}{ball}</link>'
        f'<link name="wheel">{inertial.format(0.1)}</link>'
        '<joint name="spin" type="continuous"><parent link="trunk"/><child link="wheel"/><axis xyz="0 0 1"/></joint></robot>'
    )
    time = np.arange(0.0, 0.4, 0.01)
    still, fall = np.zeros((len(time), 3)), np.zeros((len(time), 3))
    fall[:, 2] = 2.0 - 0.5 * 9.81 * time**2
    channels = (Channel("position", ("spin",), "rad", time, 0.1 * np.sin(time)[:, None]),
                Channel("base_position", ("x", "y", "z"), "m", time, fall),
                Channel("base_orientation", ("roll", "pitch", "yaw"), "rad", time, still))  # fmt: skip
    taken, _ = suited(load(tmp_path / "ball.urdf"), [Recording("fall", {c.name: c for c in channels})])
    simulator, notes = simulator_for(tmp_path / "ball.urdf", taken)
    assert any("'trunk' was set free" in note for note in notes)
    (run,) = simulator.shipped().rollout([Trial.of(taken[0])], np.zeros((1, 0)))
    np.testing.assert_allclose(run.channels["base_position"][0][:, 2], fall[:, 2], atol=5e-3)


def test_a_recording_replayed_in_windows_is_shown_whole(tmp_path: Path) -> None:
    weak = _DOG.format(mass=4.0, kp=30.0)  # a model that whole replays lead astray
    ready = prepare(_written(tmp_path, weak), [_squats()], propose=False)
    (recording,) = ready.recordings
    found = replays(ready.simulator, ready.simulator.parameters.nominal, [], [recording], windows=0.5)
    assert {r.recording for r in found} == {"squats"}
    for replay in found:
        np.testing.assert_allclose(replay.time, recording.time)
        np.testing.assert_array_equal(replay.measured, recording.channel(replay.channel).values)
    whole = replays(ready.simulator, ready.simulator.parameters.nominal, [], [recording], windows=np.inf)
    assert {r.window for r in whole} == {np.inf}
    assert all(0.25 < r.window < 0.75 for r in found)
    # Each window begins where the robot was then.
    cut, uncut = (sum(np.abs(r.after - r.measured)[50::50].sum() for r in rows) for rows in (found, whole))
    assert cut < 0.2 * uncut


def test_servos_that_legs_lack_carry_the_robot(tmp_path: Path) -> None:
    bare = re.sub("<actuator>.*</actuator>", "", _DOG.format(mass=4.0, kp=40.0))
    ready = prepare(_written(tmp_path, bare), [_squats()], propose=False)
    assert any("position servos" in note for note in ready.notes)
    found = replays(ready.simulator, ready.simulator.parameters.nominal, [], ready.recordings, windows=0.5)
    height = next(r for r in found if r.channel == "base_position")
    assert np.abs(height.after - height.measured)[:, height.labels.index("z")].max() < 0.02


def test_a_base_that_nobody_saw_begins_at_the_keyframe_once_and_not_in_each_window(tmp_path: Path) -> None:
    dog, (x, y, z) = _squats(), (float(v) for v in _squats().channel("base_position").values[0])
    key = f'<keyframe><key qpos="{x} {y} {z} 1 0 0 0 0 0 0 0 0 0 0 0"/></keyframe></mujoco>'
    path = _written(tmp_path, _DOG.format(mass=4.0, kp=40.0).replace("</mujoco>", key))
    unseen = Recording("squats", {n: dog.channel(n) for n in ("command", "position")})
    ready = prepare(path, [unseen], propose=False, refuse=["base"])
    (shown,) = replays(ready.simulator, np.zeros(0), list(ready.recordings), [], windows=0.5)
    assert np.sqrt(np.mean((shown.after - shown.measured) ** 2)) < 2e-3
    assert not predicted_ahead(ready.simulator, np.zeros(0), list(ready.recordings), ["position"])


def test_a_base_that_moves_while_the_model_stands_fixed_is_said(tmp_path: Path) -> None:
    squats, path = _squats(), tmp_path / "dog.xml"
    path.write_text(_DOG.format(mass=4.0, kp=40.0).replace('<freejoint name="root"/>', ""))
    (note,) = check_base(load(path), [squats])
    way = np.max(np.ptp(squats.channel("base_position").values, axis=0))
    assert f"'base_position' moves by {way:.3g} m in '{squats.name}', but model 'dog.xml' stands fixed" in note
    place = squats.channel("base_position")
    assert not check_base(load(path), [squats.with_channel(place.replace(values=np.tile(place.values[:1], (200, 1))))])
