# SPDX-License-Identifier: Apache-2.0
"""Commands reach the drives that can take them: torques motors, positions servos; whatever cannot is said."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.arrays import Array
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.mujoco.setup.drives import suited
from trueup.engines.mujoco.wiring import is_speed_servo
from trueup.engines.mujoco.writing.notes import about_masses
from trueup.errors import ModelError, RecordingError
from trueup.loop.calibrate import Options, calibrate
from trueup.loop.checks import check
from trueup.loop.fit import DESCENT
from trueup.loop.prepare import prepare, simulator_for
from trueup.recording import Channel, Recording
from trueup.trial import Trial

QUICK = Options(cross_validate=False, lacking=False, stages=DESCENT)

_ARM = """<mujoco><worldbody><body><joint name="j" axis="0 1 0" damping="{damping}"/>
<geom size=".05" mass="1" pos="0 0 -.2"/></body></worldbody>{drive}</mujoco>"""
_MOTOR = '<actuator><motor name="m" joint="j" gear="5"/></actuator>'
_SERVO = '<actuator><position name="m" joint="j" kp="20"/></actuator>'


def _model(folder: Path, drive: str) -> Path:
    path = folder / "arm.xml"
    path.write_text(_ARM.format(damping=0.3, drive=drive))
    return path


def _swing() -> Recording:
    """A pendulum with damping 0.5 that torques of 0.3 N m at the joint swing."""
    model = mujoco.MjModel.from_xml_string(_ARM.format(damping=0.5, drive=_MOTOR))
    data, time = mujoco.MjData(model), np.arange(0.0, 4.0, 0.01)
    torque, noise, seen = 0.3 * np.sin(2.0 * time), np.random.default_rng(0).normal(0.0, 1e-4, len(time)), []
    for wanted in torque:
        seen.append(data.qpos[0])
        data.ctrl[0] = wanted / 5.0
        mujoco.mj_step(model, data, 5)
    channels = (
        Channel("position", ("j",), "rad", time, (np.array(seen) + noise)[:, None]),
        Channel("command_torque", ("j",), "N m", time, torque[:, None]),
    )
    return Recording("swing", {c.name: c for c in channels}, {})


@pytest.mark.parametrize("drive", [_MOTOR, ""], ids=["a geared motor", "no actuator"])
def test_commanded_torques_drive_the_model(tmp_path: Path, drive: str) -> None:
    simulator, notes = simulator_for(_model(tmp_path, drive), [_swing()])
    assert any("motors were added" in n for n in notes) == (not drive)
    found = calibrate(simulator, [_swing()], options=Options(cross_validate=False, lacking=False))
    (damping,) = [e for e in found.estimates if e.name == "j.damping"]
    assert damping.low < 0.5 < damping.high
    assert damping.value == pytest.approx(0.5, rel=0.03)


@pytest.mark.parametrize(
    "servo", ['position name="m" joint="j" kp="20" timeconst="0.1"', 'intvelocity name="m" joint="j" kp="20"']
)
def test_a_drive_with_a_state_of_its_own_starts_settled(tmp_path: Path, servo: str) -> None:
    """A servo that smooths its command, and one that integrates a speed, hold the arm up from the first sample on."""
    path = _model(tmp_path, f"<actuator><{servo}/></actuator>")
    speed = servo.startswith("intvelocity")
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.timestep = 5e-4
    data, time, seen = mujoco.MjData(model), np.arange(0.0, 2.0, 0.01), []
    told = 0.3 * np.cos(3.0 * time) if speed else 0.8 + 0.3 * np.sin(3.0 * time)
    data.qpos[0] = data.act[0] = 0.8
    data.ctrl[0] = 0.0 if speed else 0.8
    mujoco.mj_step(model, data, 4000)  # hangs a little below
    for wanted in told:
        seen.append(data.qpos[0])
        data.ctrl[0] = wanted
        mujoco.mj_step(model, data, 20)
    name, unit = ("command_velocity", "rad/s") if speed else ("command", "rad")
    log = Recording("log", {
        name: Channel(name, ("j",), unit, time, told),
        "position": Channel("position", ("j",), "rad", time, np.array(seen)),
    })  # fmt: skip
    simulator, _ = simulator_for(path, [log])
    (run,) = simulator.shipped().rollout([Trial.of(log, ["position"])], np.zeros((1, 0)))
    off = np.abs(run.channels["position"][0, :, 0] - seen).max()
    assert off < (0.1 if speed else 3e-3)  # how far an integrator's set point is above the arm is not known


@pytest.mark.parametrize(
    "kind",
    [
        "cylinder timeconst='.1'",
        "muscle force='20' lengthrange='-3 3'",
        "damper kv='1' ctrlrange='0 1'",
        "intvelocity kp='20'",
    ],
)
def test_positions_are_told_to_servos_and_not_to_what_takes_something_else(tmp_path: Path, kind: str) -> None:
    """Pressures, excitations, coefficients and speeds are no positions: an arm told 0.8 rad went its own way."""
    named = kind.replace(" ", ' name="m" joint="j" ', 1)
    path = _model(tmp_path, f"<actuator><{named}/></actuator>")
    time = np.arange(0.0, 3.0, 0.01)
    rows = np.full((len(time), 1), 0.8)
    log = Recording("log", {n: Channel(n, ("j",), "rad", time, rows) for n in ("command", "position")})
    ready = prepare(path, [log])
    assert any("position servos took their place" in note for note in ready.notes)
    (run,) = ready.simulator.rollout([Trial.of(log, ["position"])], ready.simulator.parameters.nominal[None])
    assert np.abs(run.channels["position"] - 0.8).max() < 0.05


def test_of_positions_and_torques_a_model_with_motors_takes_the_torques(tmp_path: Path) -> None:
    swing = _swing()
    both = swing.with_channel(swing.channel("position").replace(name="command"))
    (kept,), notes = suited(load(_model(tmp_path, _MOTOR)), [both])
    assert not kept.has("command")
    assert "torques are used" in notes[0]
    (kept,), notes = suited(load(_model(tmp_path, _SERVO)), [both])
    assert kept.has("command")
    assert not notes


def test_commands_that_the_drives_cannot_take_are_refused(tmp_path: Path) -> None:
    swing = _swing()
    with pytest.raises(ModelError, match=r"'swing' commands N m .* has position servos at j"):
        suited(load(_model(tmp_path, _SERVO)), [swing])


def _steps(servo: str) -> Recording:
    """A pendulum with damping 0.3 whose `servo` is told to jump by 1 rad every 1.6 s."""
    arm = _ARM.format(damping=0.3, drive=servo).replace("<joint", '<joint armature=".01"')
    truth = mujoco.MjModel.from_xml_string(arm)
    truth.opt.timestep = 5e-4
    data, time = mujoco.MjData(truth), np.arange(0.0, 6.0, 0.01)
    wanted, seen = 0.5 * np.sign(np.sin(2.0 * time)) * (time > 0.5), []
    for target in wanted:
        seen.append(data.qpos[0])
        data.ctrl[0] = target
        mujoco.mj_step(truth, data, 20)
    measured = np.array(seen) + np.random.default_rng(0).normal(0.0, 1e-3, len(time))
    channels = [Channel("position", ("j",), "rad", time, measured[:, None]),
                Channel("command", ("j",), "rad", time, wanted[:, None])]  # fmt: skip
    return Recording("steps", {c.name: c for c in channels})


def _found(path: Path, recording: Recording, kinds: tuple[str, ...]) -> list[float]:
    """What a calibration that proposes its parameters itself finds for these."""
    (taken,), _ = suited(load(path), [recording])
    simulator, _ = simulator_for(path, [taken])
    found = {
        e.name: e.value
        for e in calibrate(simulator, [taken], options=Options(cross_validate=False, lacking=False)).estimates
    }
    return [next(value for name, value in found.items() if name.endswith(f".{kind}")) for kind in kinds]


@pytest.mark.parametrize("drive", [_MOTOR, ""], ids=["a geared motor", "no actuator"])
def test_the_controller_in_the_robot_is_found_where_the_model_has_none(tmp_path: Path, drive: str) -> None:
    steps = _steps('<actuator><position joint="j" kp="35" kv="1.1"/></actuator>')
    _, notes = simulator_for(_model(tmp_path, drive), [steps])
    assert any("position servos" in n for n in notes)
    stiffness, of_servo, of_joint = _found(_model(tmp_path, drive), steps, ("kp", "kv", "damping"))
    assert stiffness == pytest.approx(35.0, rel=0.1)
    assert of_servo + of_joint == pytest.approx(1.4, rel=0.1)


def test_steps_show_the_force_limit_of_a_motor(tmp_path: Path) -> None:
    steps = _steps('<actuator><position joint="j" kp="35" kv="1.1" forcerange="-6 6"/></actuator>')
    limited = _model(tmp_path, _MOTOR.replace("/>", ' ctrlrange="-2 2"/>', 1))  # 10 N m by the gear
    force, acceleration = _found(limited, steps, ("force_limit", "acceleration_limit"))
    assert force == pytest.approx(6.0, rel=0.1)
    assert acceleration > 1e5, "a limit of what is commanded only makes up for coarse steps"


def test_logs_of_which_none_says_what_the_drives_did_are_refused(tmp_path: Path) -> None:
    silent = _swing().without("command_torque")
    with pytest.raises(
        RecordingError, match=r"no command in swing.*seen: position \(j\).*command_torque.*labels = \[.j.\]"
    ):
        simulator_for(_model(tmp_path, _MOTOR), [silent])
    off = Channel("torque_enable", ("j",), "", silent.time, np.zeros((len(silent.time), 1)))
    _, notes = simulator_for(_model(tmp_path, _MOTOR), [silent.with_channel(off)])
    assert any(n.startswith("no command in swing: there servos hold") for n in notes)
    simulator_for(_model(tmp_path, ""), [silent])  # a passive model
    amperes = Channel("command_current", ("j",), "A", silent.time, np.ones((len(silent.time), 1)))
    with pytest.raises(RecordingError, match=r"command_current: .*torque constant.*command_torque.*scale"):
        simulator_for(_model(tmp_path, _MOTOR), [silent.with_channel(amperes)])


def test_duties_are_said_to_be_the_controls_of_motors_which_they_drive_then(tmp_path: Path) -> None:
    swing = _swing()
    told = swing.channel("command_torque")
    shares = told.replace(values=told.values / 5.0, unit="")  # of a motor that gives 5 N m
    log = swing.without("command_torque").with_channel(shares.replace(name="duty"))
    with pytest.raises(RecordingError, match=r"duty: if these drove the motors.* controls .*unit = \"%\" or none"):
        simulator_for(_model(tmp_path, _MOTOR), [log])
    simulator, _ = simulator_for(_model(tmp_path, _MOTOR), [swing])
    as_torque, as_shares = (
        simulator.rollout([Trial.of(run)], simulator.parameters.nominal[None])[0].channels["position"]
        for run in (swing, swing.with_channel(shares))
    )
    np.testing.assert_allclose(as_shares, as_torque)


def test_a_log_without_commands_beside_others_is_said_to_drive_nothing(tmp_path: Path) -> None:
    ready = prepare(_model(tmp_path, _MOTOR), [_swing()], [_swing().without("command_torque").replace(name="silent")])
    assert any(n.startswith("no command in silent, unlike in the others") for n in ready.notes)
    warnings = check(ready.recordings, ready.hold_out)
    assert any("silent: no command" in w for w in warnings)


def test_a_drive_that_nothing_commands_though_its_joint_moves_is_named(tmp_path: Path) -> None:
    two = _ARM.format(damping=0.3, drive="<actuator><position joint='j'/><position name='calf' joint='k'/></actuator>")
    path = tmp_path / "leg.xml"
    path.write_text(
        two.replace("<geom", "<body pos='0 0 -.4'><joint name='k' axis='0 1 0'/><geom size='.05'/></body><geom", 1)
    )
    time = np.arange(0.0, 2.0, 0.01)
    moved = np.stack([np.sin(time), 0.3 * np.sin(3.0 * time)], axis=1)
    command = Channel("command", ("j",), "rad", time, moved[:, :1])

    def notes(knee: float) -> list[str]:
        position = Channel("position", ("j", "k"), "rad", time, moved * [1.0, knee])
        return list(simulator_for(path, [Recording("air", {c.name: c for c in (command, position)})])[1])

    assert any("nothing commands calf in air, though the joint moves there" in n for n in notes(1.0))
    assert not any("nothing commands" in n for n in notes(0.0))


def _measured() -> Recording:
    """The swing, with its torques as measured ones."""
    torque = _swing().channel("command_torque").replace(name="torque")
    return _swing().without("command_torque").with_channel(torque)


@pytest.mark.parametrize("drive", [_MOTOR, ""], ids=["a geared motor", "no actuator"])
def test_measured_torques_drive_what_nothing_commands(tmp_path: Path, drive: str) -> None:
    ready = prepare(_model(tmp_path, drive), [_measured()])
    assert ("torques", False) in [(d.name, d.refused) for d in ready.diagnoses]
    np.testing.assert_array_equal(
        ready.recordings[0].channel("command_torque").values, _swing().channel("command_torque").values
    )
    (damping,) = [e for e in ready.calibrate(QUICK).estimates if e.name == "j.damping"]
    assert damping.value == pytest.approx(0.5, rel=0.03)


def test_measured_torques_stay_what_was_measured_where_that_is_wanted_or_others_are_commanded(tmp_path: Path) -> None:
    for ready in (
        prepare(_model(tmp_path, _MOTOR), [_measured()], refuse=["torques"]),
        prepare(_model(tmp_path, _MOTOR), [_measured(), _swing().replace(name="commanded")]),
    ):
        assert ready.recordings[0].has("torque")
        assert not ready.recordings[0].has("command_torque")
    with pytest.raises(RecordingError, match=r"\[channels.command\]"):
        prepare(_model(tmp_path, _SERVO), [_measured()])  # servos take no torques


_TENDON = """<mujoco><option timestep=".002" integrator="implicitfast"/><worldbody>
<body><joint name="a" axis="0 1 0" damping=".3" armature=".01"/><geom size=".03" mass=".3" pos="0 0 -.1"/>
<body pos="0 0 -.1"><joint name="b" axis="0 1 0" damping=".1" armature=".002"/><geom size=".02" mass=".1" pos="0 0 -.1"/>
</body></body></worldbody><tendon><fixed name="t"><joint joint="a" coef="1"/><joint joint="b" coef="1"/></fixed></tendon>
<actuator><position name="pull" tendon="t" kp="{kp}"/></actuator></mujoco>"""


def test_a_servo_that_pulls_two_joints_by_a_tendon_is_commanded_by_its_name_and_calibrated(tmp_path: Path) -> None:
    path = tmp_path / "finger.xml"
    path.write_text(_TENDON.format(kp=6))
    truth = mujoco.MjModel.from_xml_string(_TENDON.format(kp=9))
    data, time, seen, told = mujoco.MjData(truth), np.arange(0.0, 6.0, 0.01), [], []
    for t in time:
        told.append(0.6 * np.sin(2.0 * t))
        seen.append(data.qpos.copy())
        data.ctrl[0] = told[-1]
        mujoco.mj_step(truth, data, 5)
    log = Recording("log", {
        "command": Channel("command", ("pull",), "rad", time, np.array(told)),
        "position": Channel("position", ("a", "b"), "rad", time, np.array(seen)),
    })  # fmt: skip
    ready = prepare(path, [log])
    (taken,) = ready.recordings
    assert taken.channel("command").labels == ("pull",)
    assert not ready.notes
    (kp,) = _found(path, taken, ("kp",))
    assert kp == pytest.approx(9.0, rel=0.05)


def test_a_servo_that_pulls_two_joints_has_the_delay_of_all_commands_and_a_zero(tmp_path: Path) -> None:
    path = tmp_path / "finger.xml"
    path.write_text(_TENDON.format(kp=6))
    time = np.arange(0.0, 2.0, 0.01)
    log = Recording("log", {
        "command": Channel("command", ("pull",), "rad", time, 0.6 * np.sin(2.0 * time)[:, None]),
        "position": Channel("position", ("a", "b"), "rad", time, 0.3 * np.sin(2.0 * time - 0.1)[:, None] * np.ones(2)),
    })  # fmt: skip
    simulator = prepare(path, [log]).simulator
    assert isinstance(simulator, MujocoSimulator)
    of = {a.kind: a.targets for a in simulator.quantities}
    assert of["delay"] == of["zero"] == ("pull",)


def test_steps_show_the_force_limit_of_a_servo_whose_file_gives_none(tmp_path: Path) -> None:
    steps = _steps('<actuator><position joint="j" kp="35" kv="1.1" forcerange="-4 4"/></actuator>')
    force, stiffness = _found(_model(tmp_path, _SERVO), steps, ("force_limit", "kp"))
    assert force == pytest.approx(4.0, rel=0.1)
    assert stiffness == pytest.approx(35.0, rel=0.05)


def test_a_log_that_numbers_its_motors_counts_them_as_the_actuators_stand(tmp_path: Path) -> None:
    """Files of quadrupeds have the left leg's body first, and the right one's motors, as the robot counts."""
    leg = "<body pos='0 {} 0'><joint name='{}_hip' axis='1 0 0'/><geom size='.05' pos='0 {} -.2'/></body>"
    motors = "".join(f"<motor name='{side}' joint='{side}_hip'/>" for side in ("right", "left"))
    text = f"<mujoco><worldbody>{leg.format(0.1, 'left', 0.1)}{leg.format(-0.1, 'right', -0.1)}</worldbody>"
    (tmp_path / "dog.xml").write_text(f"{text}<actuator>{motors}</actuator></mujoco>")
    time = np.arange(0.0, 2.0, 0.01)
    values = np.stack([np.sin(3.0 * time), np.cos(2.0 * time)], axis=1)
    channels = [Channel(n, ("joint_0", "joint_1"), "rad", time, values) for n in ("command", "position")]
    ready = prepare(tmp_path / "dog.xml", [Recording("log", {c.name: c for c in channels})])
    (log,) = ready.recordings
    np.testing.assert_array_equal(log.channel("position").column("right_hip"), values[:, 0])
    assert any("joint_0 -> right_hip, joint_1 -> left_hip" in note for note in ready.notes)


_SPEED = '<actuator><velocity name="m" joint="j" kv="1"/></actuator>'


def _paced() -> Recording:
    """A pendulum whose drive has a loop of speed with a gain of 4 N m s/rad, and hinges with damping of 0.3."""
    model = mujoco.MjModel.from_xml_string(_ARM.format(damping=0.3, drive=_SPEED.replace('kv="1"', 'kv="4"')))
    data, time = mujoco.MjData(model), np.arange(0.0, 4.0, 0.01)
    told, noise, seen = 0.8 * np.sin(3.0 * time) + 0.5, np.random.default_rng(0).normal(0.0, 1e-4, len(time)), []
    for wanted in told:
        seen.append(data.qpos[0])
        data.ctrl[0] = wanted
        mujoco.mj_step(model, data, 5)
    channels = (
        Channel("position", ("j",), "rad", time, (np.array(seen) + noise)[:, None]),
        Channel("command_velocity", ("j",), "rad/s", time, told[:, None]),
    )
    return Recording("paced", {c.name: c for c in channels}, {})


@pytest.mark.parametrize("drive", [_SPEED, _SERVO, _MOTOR, ""], ids=["of speed", "of position", "a motor", "none"])
def test_commanded_speeds_drive_a_servo_of_speed_whatever_the_file_has(tmp_path: Path, drive: str) -> None:
    """As angles of a position servo, or torques of a motor, they moved the joint somewhere else without a word."""
    simulator, notes = simulator_for(_model(tmp_path, drive), [_paced()])
    assert any("servos of speed" in n for n in notes) == (drive != _SPEED)
    found = calibrate(simulator, [_paced()], options=QUICK)
    gain = next(e.value for e in found.estimates if e.name == "j.gain" or e.name == "m.gain")
    kv = simulator.model.compiled.actuator_gainprm[0, 0] * gain
    assert kv == pytest.approx(4.0, rel=0.05)
    (note,) = [
        n for n in about_masses(simulator, found) if "in proportion to the masses" in n
    ]  # a pendulum's weight alone
    assert "gain" in note.partition(" are ")[0].split(", ")


def test_of_positions_and_speeds_a_servo_of_speed_takes_the_speeds(tmp_path: Path) -> None:
    paced = _paced()
    both = paced.with_channel(paced.channel("position").replace(name="command"))
    (run,), _ = suited(load(_model(tmp_path, _SPEED)), [both])
    assert (run.has("command"), run.has("command_velocity")) == (False, True)
    (run,), _ = suited(load(_model(tmp_path, _SERVO)), [both])
    assert run.has("command")


_LEG = """<mujoco><compiler angle="radian"/><worldbody><body><joint name="knee" axis="0 1 0" range="-2 2" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".3"/>
<body pos=".2 0 0"><joint name="wheel" axis="0 1 0" damping="0.01"/>
<geom type="cylinder" size=".05 .01" euler="1.57 0 0" mass=".2"/></body></body></worldbody>
<actuator><position name="knee" joint="knee" kp="8" kv=".4"/>
<velocity name="wheel" joint="wheel" kv="0.1"/></actuator></mujoco>"""


def _rolling(path: Path, scale: float = 1.0) -> Recording:
    """A leg that is told where to be, and its wheel how fast to turn, or by `scale` (N m s/rad) with which torque."""
    model, time = mujoco.MjModel.from_xml_path(str(path)), np.arange(0.0, 6.0, 0.01)
    data, there = mujoco.MjData(model), []
    told = np.stack([0.4 * np.sin(2.0 * time), scale * (6.0 + 3.0 * np.sin(1.3 * time))], axis=1)
    for asked in told:
        there.append(data.qpos.copy())
        data.ctrl[:] = asked
        mujoco.mj_step(model, data, 5)
    position = Channel("position", ("knee", "wheel"), "rad", time, np.array(there))
    return Recording(
        "roll", {"position": position, "command": Channel("command", ("knee", "wheel"), "rad", time, told)}
    )


@pytest.mark.parametrize("apart", ["", "rad/s", "no unit"])
def test_wheels_on_legs_are_told_speeds_beside_positions_of_the_other_joints(apart: str, tmp_path: Path) -> None:
    """In a channel of their own, or among the others where nobody says what they are: wheels were held where they began, or
    a servo of position took the place of theirs.
    """
    path = tmp_path / "leg.xml"
    path.write_text(_LEG)
    run = _rolling(path)
    if apart:
        command = run.channel("command")
        speeds = command.select(["wheel"]).replace(name="command_velocity", unit=apart.replace("no unit", ""))
        run = run.with_channel(command.select(["knee"])).with_channel(speeds)
    ready = prepare(path, [run])
    assert not any("nothing commands" in n or "took their place" in n for n in ready.notes)
    assert any("taken as told speeds" in n for n in ready.notes) == (not apart)
    command = ready.recordings[0].channel("command")
    assert [command.unit_of(x) for x in ("knee", "wheel")] == ["rad", "rad/s"]
    simulator, trial = MujocoSimulator(load(path), step=0.002), Trial.of(ready.recordings[0], ["position"])
    (found,) = simulator.rollout([trial], np.zeros((1, 0)))
    assert np.abs(found.channels["position"][0] - run.channel("position").values).max() < 0.02


@pytest.mark.parametrize("drive", ["velocity", "position", ""])
def test_joints_told_speeds_have_servos_of_speed_beside_those_told_positions(drive: str, tmp_path: Path) -> None:
    """Where the file has no drives, joints that were told speeds were left without any, and the speeds without a word."""
    path, bare = tmp_path / "leg.xml", tmp_path / "bare.xml"
    path.write_text(_LEG)
    other = _LEG.replace("<velocity", f"<{drive}").replace('kv="0.1"', "")
    bare.write_text(other if drive else re.sub(r"<actuator>.*</actuator>", "", _LEG, flags=re.DOTALL))
    run = _rolling(path)
    command = run.channel("command")
    speeds = command.select(["wheel"]).replace(name="command_velocity", unit="rad/s")
    ready = prepare(bare, [run.with_channel(command.select(["knee"])).with_channel(speeds)])
    assert isinstance(ready.simulator, MujocoSimulator)
    compiled = ready.simulator.model.compiled
    assert [is_speed_servo(compiled, compiled.actuator(n).id) for n in ("knee", "wheel")] == [False, True]
    assert [ready.recordings[0].channel("command").unit_of(x) for x in ("knee", "wheel")] == ["rad", "rad/s"]


@pytest.mark.parametrize("apart", [True, False])
def test_wheels_on_legs_are_told_torques_beside_positions_of_the_other_joints(apart: bool, tmp_path: Path) -> None:
    """In a channel of their own, or with a unit of their own among the others: wheels were held where they began, or torques
    were positions of a servo that took the place of the motor.
    """
    path = tmp_path / "leg.xml"
    path.write_text(
        _LEG.replace('<velocity name="wheel" joint="wheel" kv="0.1"/>', '<motor name="wheel" joint="wheel"/>')
    )
    run = _rolling(path, 0.01)
    command = run.channel("command")
    if apart:
        torque = command.select(["wheel"]).replace(name="command_torque", unit="N m")
        run = run.with_channel(command.select(["knee"])).with_channel(torque)
    else:
        run = run.with_channel(command.replace(units=("rad", "N m")))
    ready = prepare(path, [run])
    assert not any(
        said in n for n in ready.notes for said in ("nothing commands", "took their place", "beside positions")
    )
    command = ready.recordings[0].channel("command")
    assert [command.unit_of(x) for x in ("knee", "wheel")] == ["rad", "N m"]
    simulator, trial = MujocoSimulator(load(path), step=0.002), Trial.of(ready.recordings[0], ["position"])
    (found,) = simulator.rollout([trial], np.zeros((1, 0)))
    assert np.abs(found.channels["position"][0] - run.channel("position").values).max() < 0.02


def test_torques_told_to_a_servo_among_positions_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "leg.xml"
    path.write_text(_LEG)
    run = _rolling(path)
    run = run.with_channel(run.channel("command").replace(units=("rad", "N m")))
    with pytest.raises(ModelError, match=r"commands N m .* servos of speed at wheel"):
        prepare(path, [run])


def _told(recording: Recording) -> Recording:
    """What was commanded, under a name and in a unit of positions, as a column 'j_cmd' without a unit is read."""
    torque = recording.channel("command_torque")
    return recording.without("command_torque").with_channel(torque.replace(name="command", unit="rad"))


def test_torques_told_as_positions_drive_motors_that_would_give_the_motion(tmp_path: Path) -> None:
    ready = prepare(_model(tmp_path, _MOTOR), [_told(_swing())])
    assert any("is taken as torques in N m" in str(d) for d in ready.diagnoses)
    (torque,) = [r.channel("command_torque") for r in ready.recordings]
    assert torque.unit_of("j") == "N m"
    np.testing.assert_array_equal(torque.values, _swing().channel("command_torque").values)
    (damping,) = [
        e for e in ready.calibrate(Options(cross_validate=False, lacking=False)).estimates if e.name == "j.damping"
    ]
    assert damping.value == pytest.approx(0.5, rel=0.03)
    as_told = prepare(_model(tmp_path, _MOTOR), [_told(_swing())], refuse=["torques"]).recordings[0]
    assert as_told.channel("command").unit == "rad"


def test_positions_that_joints_follow_stay_positions_beside_motors(tmp_path: Path) -> None:
    time = np.arange(0.0, 4.0, 0.01)
    wanted, moved = np.sin(2.0 * time)[:, None], 0.8 * np.sin(2.0 * time - 0.3)[:, None]
    channels = (Channel("command", ("j",), "rad", time, wanted), Channel("position", ("j",), "rad", time, moved))
    ready = prepare(_model(tmp_path, _MOTOR), [Recording("followed", {c.name: c for c in channels})])
    assert not any("torques" in d.name for d in ready.diagnoses)
    assert ready.recordings[0].channel("command").unit == "rad"


def _carted(model: mujoco.MjModel, time: Array, told: Array, noise: float) -> Recording:
    """A cart that follows commands (T,) in m at 100 Hz, and the pendulum below it, which is seen with `noise` in mrad."""
    data, seen = mujoco.MjData(model), []
    for wanted in told:
        seen.append(data.qpos.copy())
        data.ctrl[0] = wanted
        mujoco.mj_step(model, data, 5)
    noisy = np.array(seen) + noise * np.random.default_rng(0).normal(0.0, 1.0, (len(time), 2)) * [5e-5, 1e-3]
    return Recording("log", {
        "command": Channel("command", ("cart",), "m", time, told[:, None]),
        "position": Channel("position", ("cart", "swing"), "", time, noisy, units=("m", "rad")),
    })  # fmt: skip


def test_what_slows_a_small_pendulum_is_found_below_what_any_gear_of_an_arm_has(tmp_path: Path) -> None:
    """20 g on 12 cm, whose bearing has a hundredth of the least friction of servos, swing out below a slide that moved."""
    text = """<mujoco><worldbody><body><joint name="cart" type="slide" axis="1 0 0"/><geom size=".03" mass=".5"/><body>
    <joint name="swing" axis="0 1 0" damping="{damping}"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.12" size=".004" mass=".02"/>
    </body></body></worldbody><actuator><position joint="cart" kp="200" kv="20"/></actuator></mujoco>"""
    path = tmp_path / "cart.xml"
    path.write_text(text.format(damping=0.0))
    model = mujoco.MjModel.from_xml_string(text.format(damping=2e-5))
    time = np.arange(0.0, 8.0, 0.01)
    log = _carted(model, time, 0.01 * np.sin(8.0 * time) * (time < 3.0), 0.5)
    # Slopes alone end where friction does damping's work.
    found = prepare(path, [log]).calibrate(options=Options(cross_validate=False, lacking=False))
    (damping,) = [e for e in found.estimates if e.name == "swing.damping"]
    assert damping.value == pytest.approx(2e-5, rel=0.3)


def test_a_pendulum_that_nothing_drives_has_no_rotor_and_its_cart_is_not_bent_to_one(tmp_path: Path) -> None:
    """Of 20 g on 12 cm, that swing on once the cart stands: a fiftieth of their inertia too much is a lap within the log."""
    text = """<mujoco><option timestep=".002"/><worldbody><body>
    <joint name="cart" type="slide" axis="1 0 0" damping="{slow}"/><geom size=".03" mass=".5"/><body>
    <joint name="swing" axis="0 1 0" damping="{slack}" frictionloss="{slack}"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.12" size=".004" mass=".02"/>
    </body></body></worldbody><actuator><position joint="cart" kp="{kp}" kv="{kv}"/></actuator></mujoco>"""
    path = tmp_path / "cart.xml"
    path.write_text(text.format(slow=0, slack=0, kp=200, kv=10))
    model = mujoco.MjModel.from_xml_string(text.format(slow=1, slack=2e-5, kp=150, kv=12))
    time = np.arange(0.0, 12.0, 0.01)
    waves = np.sin(2.0 * np.pi * np.array([0.4, 0.9, 1.3, 1.7, 1.9]) * time[:, None] + np.arange(5.0)).sum(axis=1)
    log = _carted(model, time, 0.005 * np.minimum(time, 1.0) * waves * (time < 6.0), 1.0)
    found = {e.name: e for e in prepare(path, [log]).calibrate(options=QUICK).estimates}
    assert found["cart.kp"].value == pytest.approx(150.0, rel=0.1)
    assert found["swing.armature"].low == 0.0
    assert found["swing.armature"].high < 1e-6  # of 9.8e-5 kg m2
