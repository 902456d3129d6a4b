# SPDX-License-Identifier: Apache-2.0
"""A real RoboCup server, rcssservermj, in its own environment and process: its Booster robots stand and step."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.articulated.pose import quaternion_of
from trueup.ends import ended
from trueup.errors import TrialError
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording
from trueup.robots.rcss import RcssRobot
from trueup.robots.rcss.model import servo_model
from trueup.testing import check_robot
from trueup.trial import Observed, Trial

pytestmark = pytest.mark.rcss
BIN = Path(os.environ.get("TRUEUP_RCSS", Path(__file__).resolve().parents[2] / ".venv-rcss")) / "bin"
SIDES = ("Left", "Right")
LEG = ("Hip_Pitch", "Hip_Roll", "Knee_Pitch", "Ankle_Pitch", "Ankle_Roll")
JOINTS = tuple(f"{side}_{joint}" for side in SIDES for joint in LEG)
STANCES = {"K1": (-0.3, 0.6, -0.3), "T1": (-0.35, 0.6, -0.24)}
"""rad of hips, knees and ankles: a little crouched, the centre of mass over the soles."""


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """The port of a running server that waits for its agents."""
    if not (BIN / "rcssservermj").exists():
        pytest.skip("no RoboCup server here: `make rcss` installs one (TRUEUP_RCSS says where one is)")
    free = [socket.create_server(("127.0.0.1", 0)) for _ in range(2)]
    ports = [str(s.getsockname()[1]) for s in free]
    for s in free:
        s.close()
    command = [BIN / "python", "-m", "rcsssmj", "--host", "127.0.0.1", "--aport", ports[0], "--mport", ports[1], "--sync",
               "--no-realtime", "--no-render"]  # fmt: skip
    out = tmp_path_factory.mktemp("rcss")
    process = subprocess.Popen(command, cwd=out, stdout=subprocess.DEVNULL, stderr=(out / "said").open("w"))
    try:
        steps(out / "said", process)
        yield int(ports[0])
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def steps(said: Path, process: subprocess.Popen[bytes]) -> None:
    """Waits until the server goes through its cycles, by its own log.

    An agent that joins before its first cycle brings it down, and so may a monitor that comes to look and leaves.
    """
    for _ in range(300):
        assert process.poll() is None, said.read_text()
        if "update loop" in said.read_text():
            time.sleep(0.5)
            return
        time.sleep(0.1)


def stepping(robot: str, lift: float, seconds: float = 4.0) -> Trial:
    """Weight to one side and the other, three times in two seconds, and the free leg drawn up by `lift` rad of its hip."""
    now = np.arange(round(seconds / 0.02) + 1, dtype=np.float64) * 0.02
    phase, grown = 3.0 * np.pi * now, np.clip(now - 0.5, 0.0, 1.0)
    roll, columns = 0.1 * grown * np.sin(phase) * (lift > 0.0), []
    for sign in (1.0, -1.0):
        up = lift * grown * np.clip(sign * np.sin(phase) - 0.2, 0.0, None) / 0.8
        hip, knee, ankle = STANCES[robot]
        columns += [hip - up, roll, knee + 2.0 * up, ankle - up, -roll]
    command = Channel("command", JOINTS, "rad", now, np.stack(columns, axis=1))
    observed = {"position": Observed(JOINTS, "rad", now), "base_position": Observed(("x", "y", "z"), "m", now)}
    return Trial("stepping", 0.0, seconds, command, observed)


def own_file(robot: str) -> Path:
    """The server's own model of a robot."""
    (found,) = BIN.parent.glob(f"lib/python*/site-packages/rcsssmj/resources/robots/{robot}/robot.xml")
    return found


def soles(robot: str, run: Recording) -> np.ndarray:
    """(T, 2) m by which the feet are higher than at the start, by the server's own model of the robot."""
    model = mujoco.MjModel.from_xml_path(str(own_file(robot)))
    data, heights = mujoco.MjData(model), []
    position, place, turn = (run.channel(n) for n in ("position", "base_position", "base_orientation"))
    for k in range(len(position.time)):
        data.qpos[:7] = [*place.values[k], *quaternion_of(turn.values[k])]
        for joint, angle in zip(position.labels, position.values[k], strict=True):
            data.joint(joint).qpos[0] = angle
        mujoco.mj_kinematics(model, data)
        heights.append([data.body(f"{side.lower()}_foot_link").xpos[2] for side in SIDES])
    return np.array(heights) - np.array(heights)[:5].mean(axis=0)


@pytest.mark.parametrize("robot", ["K1", "T1"])
def test_a_booster_steps_on_the_spot_without_falling(server: int, robot: str) -> None:
    (run,) = RcssRobot(robot, port=server).perform(stepping(robot, 0.25))
    assert ended(run) is None
    height, place = soles(robot, run), run.channel("base_position").values
    for side in (0, 1):  # each foot clears the floor while the other one carries
        up = np.argmax(height[:, side])
        assert height[up, side] > 0.03
        assert abs(height[up, 1 - side]) < 0.012
    assert np.linalg.norm(place[-1, :2] - place[0, :2]) < 0.3
    assert np.allclose(np.diff(run.channel("position").time), 0.02)


def test_a_booster_stands_still_and_its_server_keeps_the_contract_of_robots(server: int) -> None:
    robot, trial = RcssRobot("T1", port=server), stepping("T1", 0.0, 2.0)
    check_robot(robot, trial)
    (run,) = robot.perform(trial)
    assert ended(run) is None
    assert np.ptp(run.channel("base_position").column("z")[25:]) < 0.02  # it sways by 3 mm, or by 8: falls are of 0.5 m
    felt = run.channel("accelerometer").values[50:].mean(axis=0)
    assert np.linalg.norm(felt) == pytest.approx(9.81, abs=0.1)
    assert np.abs(run.channel("gyro").values[50:]).max() < 0.3
    assert "seen" in run.channels


def test_the_servers_own_model_replays_it_once_commands_come_a_cycle_late(server: int, tmp_path: Path) -> None:
    plain = stepping("T1", 0.0, 2.0)
    assert plain.command is not None
    arms = ("Left_Shoulder_Pitch", "Right_Shoulder_Roll", "Left_Elbow_Pitch", "Right_Elbow_Yaw")
    swing = 0.2 + 0.2 * np.sin(4.4 * plain.command.time)[:, None] * np.array([1.0, -1.0, 1.0, 1.0])
    values = np.hstack([plain.command.values, swing])
    (run,) = RcssRobot("T1", port=server).perform(
        replace(plain, command=plain.command.replace(labels=JOINTS + arms, values=values))
    )
    simulator = prepare(servo_model("T1", own_file("T1"), tmp_path / "t1.xml"), [run], propose=False).simulator
    trial, sent = Trial.of(run, ["position", "base_position"]), run.channel("command_sent")
    wrong = {}
    for late in (0.0, 0.02, 0.04):  # its loop hands on what it heard before it tells what it sees
        delayed = replace(trial, command=sent.replace(time=sent.time + late))
        (replay,) = simulator.rollout([delayed], simulator.parameters.nominal[None])
        real, simulated = run.channel("position").select(arms), replay.recording().channel("position").select(arms)
        wrong[late] = np.sqrt(np.mean((simulated.values - real.values) ** 2))
        base = replay.recording().channel("base_position").values - run.channel("base_position").values
        assert np.abs(base).max() < 0.01
    assert wrong[0.02] < 0.005
    assert wrong[0.02] < 0.3 * min(wrong[0.0], wrong[0.04])


def test_a_robot_that_the_server_does_not_have_is_refused(server: int) -> None:
    robot = RcssRobot("K1", port=server, timeout=2.0)
    robot._body = replace(robot._body, scene="K9")
    with pytest.raises(TrialError, match=r"the connection to the RoboCup server .* was lost"):
        robot.perform(stepping("K1", 0.0, 1.0))
