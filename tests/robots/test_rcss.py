# SPDX-License-Identifier: Apache-2.0
"""An agent of RoboCup's protocol against scripted servers: a robot that keeps the contract, and messages that are no good."""

from __future__ import annotations

import contextlib
import math
import re
import socket
import struct
import threading
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trueup.campaign.kinds import ROBOTS
from trueup.campaign.making import instance
from trueup.controllers.controller import Observation
from trueup.ends import Left, ended
from trueup.errors import ParameterError, RobotFellError, TrialError, UnknownNameError
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel, Recording
from trueup.robots.rcss import RcssRobot
from trueup.robots.rcss.body import BODIES, Body
from trueup.robots.rcss.expressions import parse
from trueup.robots.rcss.percept import percept
from trueup.testing import check_robot
from trueup.trial import Observed, Trial
from trueup.typed_toml import Component

# As rcssservermj 0.2.1 sent it, but for most of its joints and landmarks; and as SimSpark's manual shows its own.
BOOSTER = (
    b"(time (now 468.95))(GS (t 0.0)(pm BeforeKickOff)(sl 0)(sr 0))(quat (n torso_quat) (q 0.707 -0.0 0.0 -0.707))"
    b"(pos (n torso_pos) (p -2.999 21.0 0.672))(GYR (n torso_gyro) (rt -0.0 -12.61 -0.0))"
    b"(ACC (n torso_acc) (a -0.0 0.0 0.47))(HJ (n q_laj2)(ax -0.93)(vx -72.51))"
    b"(See (l_llf (pol 45.97 -32.21 -1.36))(B (pol 21.12 8.17 -2.67)))"
)
SPARK = (
    b"(time (now 104.87))(GS (unum 1) (team left) (t 0.00) (pm BeforeKickOff))(GYR (n torso) (rt 0.01 0.07 0.46))"
    b"(ACC (n torso) (a 0.00 0.00 9.81))(HJ (n hj1) (ax -1.02))(UJ (n laj1 2) (ax1 -1.32) (ax2 2.00))"
    b"(FRP (n lf) (c -0.14 0.08 -0.05) (f 1.12 -0.26 13.07))(TCH n bumper val 1)(hear 0.00 self foo)"
    b"(See (P (team RoboLog) (id 1) (head (pol 16.98 -0.21 3.19)) (rlowerarm (pol 16.83 -0.06 2.80))))"
)
Handler = Callable[["Server"], None]


class Server:
    """One connection after another is handled by a function, in a thread."""

    def __init__(self, handle: Handler) -> None:
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        self.heard: list[str] = []
        self._handle, self._thread = handle, threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                self.line, _ = self._listening.accept()
                with self.line, contextlib.suppress(OSError, EOFError):
                    self._handle(self)

    def send(self, message: str | bytes) -> None:
        body = message if isinstance(message, bytes) else message.encode()
        self.line.sendall(struct.pack(">I", len(body)) + body)

    def hear(self) -> str:
        head = self.line.recv(4, socket.MSG_WAITALL)
        if len(head) < 4:
            raise EOFError
        self.heard.append(self.line.recv(struct.unpack(">I", head)[0], socket.MSG_WAITALL).decode())
        return self.heard[-1]

    def close(self) -> None:
        self._listening.close()


@contextlib.contextmanager
def serving(handle: Handler) -> Iterator[Server]:
    server = Server(handle)
    yield server
    server.close()


class Game:
    """A server's side of a robot whose joints follow their orders with a lag; it leans with its first joint."""

    def __init__(self, body: Body, speeds: bool) -> None:
        self._body, self._speeds = body, speeds

    def __call__(self, server: Server) -> None:
        angles, clock = dict.fromkeys((j.effector for j in self._body.joints), 0.0), 7.0
        if self._body.simspark:
            assert server.hear() == "(scene rsg/agent/nao/nao.rsg)"
            server.send("(time (now 7.00))(GS (t 0.00) (pm BeforeKickOff))")
        server.hear()
        while True:
            server.send(self._percept(angles, clock))
            for words in parse(server.hear().encode()):
                if isinstance(words, list) and words[0] in angles:
                    value = float(str(words[1]))
                    now = angles[str(words[0])]
                    moved = 0.02 * math.degrees(value) if self._body.simspark else 0.5 * (value - now)
                    angles[str(words[0])] = now + moved
                elif words and words[0] == "beam":
                    angles = dict.fromkeys(angles, 0.0)
            clock += 0.02

    def _percept(self, angles: dict[str, float], clock: float) -> str:
        speed = "(vx 0.0)" if self._speeds else ""
        joints = "".join(f"(HJ (n {j.perceptor})(ax {angles[j.effector]:.2f}){speed})" for j in self._body.joints)
        lean = 0.5 * math.radians(next(iter(angles.values())))
        truth = f"(quat (n torso_quat) (q {math.cos(lean)} {math.sin(lean)} 0 0))(pos (n torso_pos) (p 0 0 0.6))"
        feels = (
            f"(ACC (n torso) (a 0 {9.81 * math.sin(2 * lean)} {9.81 * math.cos(2 * lean)}))(GYR (n torso) (rt 0 0 90))"
        )
        told = f"{joints}{feels}{truth if self._speeds else ''}"
        return f"(time (now {int(100 * clock) / 100}))(GS (t 0.0)(pm BeforeKickOff)){told}"


@contextlib.contextmanager
def playing(name: str, **options: object) -> Iterator[tuple[RcssRobot, Server]]:
    body = BODIES[name]
    with serving(Game(body, speeds=not body.simspark)) as server:
        yield RcssRobot(name, port=server.port, settle=0.2, timeout=5.0, **options), server  # type: ignore[arg-type]


def swing(joints: tuple[str, ...], amplitude: float = 0.3, seconds: float = 0.6, repeats: int = 1) -> Trial:
    now = np.arange(round(seconds / 0.02) + 1, dtype=np.float64) * 0.02 + 3.0
    values = amplitude * np.sin(5.0 * (now - 3.0))[:, None] * np.ones(len(joints))
    observed = {"position": Observed(joints, "rad", now)}
    return Trial("swing", 3.0, seconds, Channel("command", joints, "rad", now, values), observed, repeats=repeats)


@pytest.mark.parametrize(("name", "joints"), [("K1", ("Left_Elbow_Pitch", "Head_pitch")), ("nao", ("laj1", "llj3"))])
def test_a_game_of_either_server_keeps_the_contract_of_robots(name: str, joints: tuple[str, ...]) -> None:
    with playing(name) as (robot, server):
        check_robot(robot, swing(joints, repeats=2))
    assert not robot.repeatable
    assert any("(beam -3.0000 0.0000 0.000)(syn)" in m for m in server.heard)


def test_joints_follow_their_orders_late_and_what_is_recorded_says_so() -> None:
    with playing("K1") as (robot, _):
        (run,) = robot.perform(swing(("Left_Elbow_Pitch",), seconds=2.0))
    real, sent = run.channel("position").column("Left_Elbow_Pitch"), run.channel("command_sent").values[:, 0]
    assert np.allclose(np.diff(run.channel("position").time), 0.02)
    lag, expected = np.zeros(len(sent)), np.asarray(sent)
    for k in range(1, len(sent)):
        lag[k] = lag[k - 1] + 0.5 * (expected[k - 1] - lag[k - 1])
    assert np.abs(real - lag).max() < 3e-4  # of a server that tells angles in hundredths of a degree
    assert {"velocity", "gyro", "accelerometer", "base_position", "base_orientation"} <= set(run.channels)
    assert np.allclose(run.channel("gyro").values[:, 2], np.pi / 2)


def test_a_speed_servo_brings_joints_of_simspark_where_they_are_asked_to_be() -> None:
    hold = swing(("llj3", "llj4"), amplitude=0.0, seconds=1.0)
    command = hold.command
    assert command is not None
    own = replace(hold, command=command.replace(labels=("hip", "knee"), values=np.tile([-0.4, 0.8], (51, 1))),
                  observed={"position": Observed(("hip", "knee"), "rad", command.time)})  # fmt: skip
    with playing("nao", joints={"hip": "-llj3", "knee": "-llj4"}) as (robot, server):
        (run,) = robot.perform(own)
    assert np.allclose(run.channel("position").select(["hip", "knee"]).values[-1], [-0.4, 0.8], atol=2e-3)
    last = re.search(r"\(lle4 (\S+)\)", server.heard[-2])
    assert last is not None
    assert abs(float(last[1])) < 0.05


def test_orders_beyond_a_joint_are_cut_and_both_are_recorded() -> None:
    with playing("K1") as (robot, _):
        (run,) = robot.perform(swing(("Left_Knee_Pitch",), amplitude=3.0))
    assert run.channel("command").values.max() > 2.9
    assert run.channel("command_sent").values.max() == pytest.approx(2.23)
    assert run.channel("command_sent").values.min() == 0.0


@pytest.mark.parametrize("name", ["K1", "nao"])
def test_a_fall_ends_a_run_and_one_before_it_is_an_answer(name: str) -> None:
    first = BODIES[name].joints[0].name
    with playing(name) as (robot, _):
        trial = swing((first,), amplitude=1.6, seconds=4.0)
        (run,) = robot.perform(replace(trial, command=slowed(trial)))
        end = ended(run)
        assert end is not None
        assert end.name == "fallen"
        assert run.channel("position").time[-1] == pytest.approx(end.at)
        lying = np.full_like(slowed(trial).values, 1.0)
        robot = RcssRobot(name, port=robot._port, settle=4.0, kp={first: 1e3})
        if name == "nao":  # K1's head does not turn so far
            with pytest.raises(RobotFellError, match="on its way to the pose"):
                robot.perform(replace(trial, command=slowed(trial).replace(values=1.5 * lying)))


def slowed(trial: Trial) -> Channel:
    assert trial.command is not None
    time = trial.command.time
    return trial.command.replace(values=1.6 * np.minimum((time - time[0])[:, None] / 2.0, 1.0))


def test_conditions_of_a_trial_end_its_run() -> None:
    end = Left("position", {"Left_Elbow_Pitch": (-1.0, 0.2)}, name="swung out")
    with playing("K1") as (robot, _):
        (run,) = robot.perform(replace(swing(("Left_Elbow_Pitch",), seconds=2.0), ends=(end,)))
        reached = ended(run)
        assert reached is not None
        assert reached.name == "swung out"
        assert run.channel("position").column("Left_Elbow_Pitch")[-1] > 0.2
        assert (run.channel("position").column("Left_Elbow_Pitch")[:-1] <= 0.2).all()


class Servo:
    """A controller that closes a loop over an elbow, and remembers what it saw."""

    period = 0.04

    def __init__(self, values: np.ndarray) -> None:
        self.gain, self.seen = values[:, :1], []

    def reset(self, observation: Observation) -> None:
        self.seen = [observation]

    def command(self, observation: Observation) -> np.ndarray:
        self.seen.append(observation)
        error = 0.5 - observation.position[:, [1]]
        return np.hstack([np.zeros((1, 1)), observation.position[:, [1]] + self.gain * error])


class Reach:
    """A task whose controller the robot is to run."""

    name = "reach"
    parameters = ParameterSpace((Parameter("gain", "1", 0.5, 0.0, 1.0),))
    trials = ()
    made: Servo

    def controllers(self, values: np.ndarray) -> Servo:
        self.made = Servo(values)
        return self.made

    def score(self, rollouts: object) -> np.ndarray:
        return np.zeros(1)


class Two:
    """As much of a simulator as says how its controllers see and command it."""

    commanded = ("Head_pitch", "Left_Elbow_Pitch")
    model: Two

    def drives(self) -> dict[str, str]:
        return {"Head_pitch": "a", "Left_Elbow_Pitch": "b", "tail": ""}

    def get(self, attribute: str, name: str) -> np.ndarray:
        return np.array([0.25])

    def observable(self, recording: Recording) -> tuple[str, ...]:
        return ()


def test_a_trial_without_a_command_is_run_by_the_tasks_own_controller() -> None:
    task, simulator = Reach(), Two()
    simulator.model = simulator
    trial = replace(swing(("Left_Elbow_Pitch",), seconds=1.0), command=None, settings={"gain": 0.8})
    with playing("K1", task=task, simulator=simulator) as (robot, _):
        (run,) = robot.perform(trial)
    assert run.channel("position").column("Left_Elbow_Pitch")[-1] == pytest.approx(0.5, abs=0.01)
    assert task.made.gain[0, 0] == 0.8
    assert len(task.made.seen) == 27  # every other cycle of 51, and at the reset
    assert task.made.seen[3].position.shape == (1, 3)
    assert task.made.seen[3].position[0, 2] == 0.25
    assert task.made.seen[3].sensors["gyro"][0, 2] == pytest.approx(np.pi / 2)
    assert run.channel("command").unit == "rad"
    with playing("K1") as (robot, _), pytest.raises(TrialError, match="neither a command to play nor a task"):
        robot.perform(trial)


# ---- what a server says ----


def test_messages_of_both_servers_are_read_in_si_units() -> None:
    seen = percept(BOOSTER)
    assert seen.time == 468.95
    assert seen.joints["q_laj2"] == pytest.approx(math.radians(-0.93))
    assert seen.speeds["q_laj2"] == pytest.approx(math.radians(-72.51))
    assert seen.gyros["torso_gyro"][1] == pytest.approx(math.radians(-12.61))
    assert seen.positions["torso_pos"] == (-2.999, 21.0, 0.672)
    assert seen.seen["B"] == pytest.approx((21.12, math.radians(8.17), math.radians(-2.67)))
    spark = percept(SPARK)
    assert spark.joints == pytest.approx(
        {"hj1": math.radians(-1.02), "laj1.1": math.radians(-1.32), "laj1.2": math.radians(2)}
    )
    assert spark.forces["lf"] == (-0.14, 0.08, -0.05, 1.12, -0.26, 13.07)
    assert spark.touches == {"bumper": (1.0,)}
    assert spark.seen["P.RoboLog.1.head"][0] == 16.98
    assert not spark.speeds


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (b"(time (now 1.0)", "brackets are left open"), (b"(time (now 1.0)))", "closes that was not opened"),
        (b"(" * 200_000, "nested more than 16 deep"), (b"(HJ (n a)(ax 1 2))", "'ax' has 2 values, not 1"),
        (b"(HJ (ax 1))", "has no name"), (b"(HJ (n a)(ax (1)))", "is no number"), (b"(TCH n a)", "lacks 'val'"),
        (b"(HJ (n a)(ax nan))", "'nan' is no number"), (b"(GYR (n a)(rt 1 2))", "'rt' has 2 values, not 3"),
        (b"(time)", "'now' has 0 values"), (b"(See (B (pol 1 x 2)))", "'x' is no number"),
    ],
)  # fmt: skip
def test_a_malformed_message_is_named(message: bytes, words: str) -> None:
    with pytest.raises(TrialError, match=re.escape(words)):
        percept(message)


def test_what_is_not_known_of_a_message_is_passed_over() -> None:
    assert percept(b"\xff\xfe junk (new (thing 1 (2)) x)(time (now 1.5))(())((a) b)").time == 1.5


def garbled(rng: np.random.Generator) -> bytes:
    letters = bytearray(BOOSTER)
    for _ in range(rng.integers(1, 6)):
        at = int(rng.integers(len(letters)))
        letters[at : at + int(rng.integers(0, 9))] = bytes(
            rng.integers(0, 256, size=int(rng.integers(0, 9)), dtype=np.uint8)
        )
    return bytes(letters)


def test_no_garbled_message_breaks_the_reader(rng: np.random.Generator) -> None:
    for _ in range(400):
        with contextlib.suppress(TrialError):
            percept(garbled(rng))


def silent(server: Server) -> None:
    server.hear()
    threading.Event().wait(1.0)


def half(server: Server) -> None:
    server.hear()
    server.line.sendall(struct.pack(">I", 100) + b"(time (now 1")


def page(server: Server) -> None:
    server.line.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")


def gone(server: Server) -> None:
    server.hear()


def stranger(server: Server) -> None:
    server.hear()
    server.send("(time (now 1.0))(HJ (n wheel)(ax 0))")
    server.hear()


def restarted(server: Server) -> None:
    body, server_clock = BODIES["K1"], iter([5.0, 5.02, 5.04, 0.0])
    server.hear()
    for now in server_clock:
        server.send(f"(time (now {now}))" + "".join(f"(HJ (n {j.perceptor})(ax 0))" for j in body.joints))
        server.hear()


def mute(server: Server) -> None:
    server.hear()
    while True:
        server.send("(time (now 1.0))")
        server.hear()


@pytest.mark.parametrize(
    ("handle", "words"),
    [
        (silent, "sent nothing whole for 0.3 s"), (half, "in the midst of a message, 12 of 100 bytes"),
        (page, "speaks another protocol"), (gone, "closed by the server"), (stranger, "it has: wheel"),
        (restarted, "ran back from 5.00 to 0.00 s"), (mute, "said nothing of joints for 0.3 s"),
    ],
)  # fmt: skip
def test_a_server_that_does_not_play_along_ends_the_run_with_its_reason(handle: Handler, words: str) -> None:
    with serving(handle) as server, pytest.raises(TrialError, match=re.escape(words)):
        RcssRobot("K1", port=server.port, timeout=0.3).perform(swing(("Head_pitch",)))


def test_no_server_is_said_with_what_starts_one() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with pytest.raises(TrialError, match="start one, such as `rcssservermj"):
        RcssRobot("T1", port=port).perform(swing(("Head_pitch",)))


def test_names_that_do_not_exist_are_told_before_anything_moves() -> None:
    with pytest.raises(UnknownNameError, match="robots are: K1, T1, nao"):
        RcssRobot("atlas")
    with pytest.raises(UnknownNameError, match="joint 'knee' is not in this robot"):
        RcssRobot("T1", port=1).perform(swing(("knee",)))
    with pytest.raises(UnknownNameError, match="did you mean 'Head_pitch'"):
        RcssRobot("T1", kp={"Head_Pitch": 3.0})
    with pytest.raises(ParameterError, match="it must be 0 or more"):
        RcssRobot("T1", kd={"Head_pitch": -3.0})
    with pytest.raises(ParameterError, match="are both the server's 'llj3'"):
        RcssRobot("nao", joints={"a": "llj3", "b": "-llj3"})
    trial = swing(("hj1",))
    asking = replace(trial, observed={"base_position": Observed(("x",), "m", trial.observed["position"].time)})
    with playing("nao") as (robot, _), pytest.raises(UnknownNameError, match="channel 'base_position' is not in what"):
        robot.perform(asking)


def test_the_page_says_how_a_plan_names_it() -> None:
    page = Path(__file__).resolve().parents[2] / "docs" / "robocup.md"
    (plan,) = re.findall(r"```toml\n(.*?)```", page.read_text("utf-8"), re.DOTALL)
    said = tomllib.loads(plan)["robot"]
    component = Component(said.pop("type"), said, "campaign.toml, [robot]")
    robot = instance(component, "robot", ROBOTS, {"task": Reach(), "simulator": None}, page.parent)
    assert isinstance(robot, RcssRobot)
    ankle = next(j for j in robot._body.joints if j.name == "Left_Ankle_Pitch")
    assert ankle.kp == 250.0
    assert robot._pose[robot.joints.index("Left_Elbow_Yaw")] == -0.5
