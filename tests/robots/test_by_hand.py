# SPDX-License-Identifier: Apache-2.0
"""A robot run by people: whatever is dropped into the inbox, only what was asked for is taken, and nothing is lost."""

from __future__ import annotations

import shutil
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.ends import Left
from trueup.errors import RobotFellError, TrialAbortedError
from trueup.parameters import Parameter
from trueup.recording import Channel, Recording
from trueup.robots.by_hand import ByHand
from trueup.robots.by_hand.check import mismatches
from trueup.robots.by_hand.sheet import words
from trueup.trial import Limits, Observed, Reference, Trial

Array = NDArray[np.float64]

RATE, DURATION = 50.0, 8.0
TIME = np.arange(round(RATE * DURATION) + 1) / RATE
JOINTS = ("hip", "knee", "ankle")


def motion() -> Array:
    """(T, 3) commanded angles, all joints different."""
    return np.stack(
        [0.6 * np.sin(0.9 * TIME), 0.4 * np.sin(1.7 * TIME + 1.0), 0.3 * np.sign(np.sin(1.1 * TIME))], axis=1
    )


def trial(name: str = "trial-001", repeats: int = 1) -> Trial:
    limits = Limits(JOINTS, np.full(3, -1.0), np.full(3, 1.0), np.full(3, 4.0), np.full(3, np.nan))
    return Trial(
        name, 0.0, DURATION, Channel("command", JOINTS, "rad", TIME, motion()),
        {"position": Observed(JOINTS, "rad", TIME)}, limits=limits, repeats=repeats,
    )  # fmt: skip


def drive(name: str, gain: float) -> Trial:
    """A run in which the robot's own controller decides: gains and a path, no command."""
    path = Reference(("x", "y"), ("m", "m"), np.stack([np.linspace(0, 8, 400), np.sin(np.linspace(0, 8, 400))], axis=1))
    return Trial(
        name, 0.0, DURATION, None, {"position": Observed(("x", "y"), "m", TIME)}, settings={"k": gain},
        references={"path": path}, tuned=(Parameter("k", "1/s", 1.0, 0.1, 5.0, source="cross-track gain"),),
        notes=("Left is positive.",),
    )  # fmt: skip


def log_text(
    head: tuple[str, ...] = ("time", *(f"cmd_{j}" for j in JOINTS), *(f"pos_{j}" for j in JOINTS)),
    order: tuple[int, ...] = (0, 1, 2), clock: float = 1.0, seconds: float = DURATION, seed: int = 0,
) -> str:  # fmt: skip
    """A log of a run as a robot would write it: commands, and positions that lag behind them."""
    rng = np.random.default_rng(seed)
    command = motion()
    position = np.stack([np.interp(TIME - 0.06, TIME, c) for c in command.T], axis=1) + 1e-3 * rng.standard_normal(
        (len(TIME), 3)
    )
    rows = np.column_stack([TIME * clock, command[:, order], position[:, order]])[seconds >= TIME]
    return ",".join(head) + "\n" + "".join(",".join(f"{v:.6g}" for v in row) + "\n" for row in rows)


class Bench:
    """An operator's desk: a robot run by hand in a folder, and what was said."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.said = folder, []
        self.inbox, self.accepted = folder / "inbox", folder / "accepted"
        self.robot = self.again()

    def again(self) -> ByHand:
        """As after switching everything off for the night."""
        self.robot = ByHand(self.folder, say=self.said.append, poll=0.01, rest=0.03)
        return self.robot

    def drop(self, name: str, text: str) -> None:
        path = self.inbox / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")

    def look(self) -> str:
        """Lets the robot look until all is at rest; what it said, as one text."""
        self.robot.look()
        time.sleep(0.05)
        self.robot.look()
        return "\n".join(self.said)

    def outcome(self, name: str = "trial-001") -> bool:
        return (self.accepted / name / "outcome.json").exists()


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def test_the_sheet_says_all_that_an_operator_needs(bench: Bench) -> None:
    bench.robot.hand_out([trial(), replace(drive("trial-002", 2.5), performs="fast lap")])
    sheet = (bench.folder / "outbox" / "trial-001" / "README.txt").read_text()
    for word in (
        "8 s",
        "hip",
        "knee",
        "ankle",
        "rad",
        "command.csv",
        "speed 4 rad/s",
        "-1 to 1 rad",
        "trial-001-aborted.txt",
    ):
        assert word in sheet
    command = np.loadtxt(bench.folder / "outbox" / "trial-001" / "command.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(command[:, 1:], motion(), atol=1e-8)
    second = bench.folder / "outbox" / "trial-002"
    assert "k,2.5,1/s" in (second / "settings.csv").read_text()
    read = (second / "README.txt").read_text()
    for word in (
        "2.5 1/s",
        "(cross-track gain)",
        "x              0 to 8 m",
        "sets no limits",
        "Left is positive.",
        "the run 'fast lap'",
        "what the controller commanded",
    ):
        assert word in read
    assert len((second / "path.csv").read_text().splitlines()) == 401


def test_a_log_without_what_the_robots_controller_commanded_is_told_of(bench: Bench) -> None:
    free = replace(trial(), command=None)
    bench.robot.hand_out([free])
    heads = ("time", *(f"pos_{j}" for j in JOINTS))
    lines = [line.split(",") for line in log_text().splitlines()]
    bench.drop("trial-001.csv", "\n".join([",".join(heads), *(",".join([c[0], *c[4:]]) for c in lines[1:])]) + "\n")
    assert "holds nothing that the controller commanded" in bench.look()


def test_a_log_that_was_asked_for_comes_back_as_the_recording(bench: Bench) -> None:
    bench.robot.hand_out([trial()])
    bench.drop("trial-001.csv", log_text())
    (recording,) = bench.robot.perform(trial())
    assert recording.channel("position").labels == JOINTS
    np.testing.assert_allclose(recording.channel("command").values, motion(), atol=1e-5)
    assert not list(bench.inbox.glob("*.csv"))
    assert (bench.accepted / "trial-001" / "trial-001.csv").read_text() == log_text()


def test_a_pose_that_motion_capture_tells_in_quaternions_is_taken(bench: Bench) -> None:
    angles = Observed(("roll", "pitch", "yaw"), "rad", TIME)
    asked = replace(trial(), observed={**trial().observed, "base_orientation": angles})
    head, *rows = log_text().splitlines()
    half = 0.1 * np.sin(TIME)  # of the pitch
    more = [f"{row},0,0,0.3,{np.cos(h):.6f},0,{np.sin(h):.6f},0" for row, h in zip(rows, half, strict=True)]
    bench.robot.hand_out([asked])
    bench.drop("trial-001.csv", "\n".join([f"{head},base_x,base_y,base_z,base_qw,base_qx,base_qy,base_qz", *more]))
    assert "accepted" in bench.look()
    (recording,) = bench.again().perform(asked)
    np.testing.assert_allclose(recording.channel("base_orientation").column("pitch"), 2.0 * half, atol=1e-5)


def test_columns_named_as_in_the_header_need_no_mapping(bench: Bench) -> None:
    bench.robot.hand_out([trial()])
    head = (bench.folder / "outbox" / "trial-001" / "log-header.csv").read_text().strip()
    assert head == "time,position/hip,position/knee,position/ankle"
    rows = [line.split(",") for line in log_text().splitlines()[1:]]
    bench.drop("whatever.csv", head + "\n" + "".join(",".join((r[0], *r[4:])) + "\n" for r in rows))
    (recording,) = bench.robot.perform(trial())
    assert recording.channel("position").unit == "rad"
    np.testing.assert_array_equal(
        recording.channel("command").values, motion()
    )  # the request, as no command was logged
    assert "no command" in recording.provenance["warnings"]


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("trial-001.csv", "date,weather\n2026,rain\n", ("trial-001.csv not taken",)),
        (
            "holiday.csv",
            "time,temp\n" + "".join(f"{t},20\n" for t in range(9)),
            ("no channel 'position'", "wrong file"),
        ),
        ("trial-001.csv", log_text(order=(1, 0, 2)), ("another order", "'hip'", "'knee'", "mapping.toml")),
        (
            "trial-001.csv",
            log_text(head=("time", "cmd_a", "cmd_b", "cmd_c", "pos_a", "pos_b", "pos_c")),
            ("lacks hip", "mapping"),
        ),
        ("trial-001.csv", log_text(seconds=3.0), ("3 s of 8 s", "broken off", "trial-001-aborted.txt")),
        ("trial-007.csv", log_text(), ("trial-007 was not asked for", "trial-001")),
        ("trial-001.csv", log_text(seed=0).replace("time", "time_s").replace("\n0.02,", "\nzero,", 1), ("not taken",)),
    ],
    ids=[
        "no numbers",
        "wrong file",
        "wrong joint order",
        "unnamed joints",
        "half a run",
        "not asked for",
        "damaged line",
    ],
)
def test_what_does_not_fit_stays_and_the_reason_is_said(
    bench: Bench, name: str, text: str, words: tuple[str, ...]
) -> None:
    bench.robot.hand_out([trial()])
    bench.drop(name, text)
    said = bench.look()
    for word in words:
        assert word in said
    assert (bench.inbox / name).read_text() == text
    assert f"{name}: " in (bench.inbox / "problems.txt").read_text()
    assert not bench.outcome()
    (bench.inbox / name).unlink()
    bench.drop("trial-001.csv", log_text(seed=1))
    assert len(bench.robot.perform(trial())) == 1
    assert (bench.inbox / "problems.txt").read_text() == ""


def test_a_clock_in_another_unit_is_named_and_a_mapping_mends_it(bench: Bench) -> None:
    bench.robot.hand_out([trial()])
    head = "time,position/hip,position/knee,position/ankle"  # the header promises s; these are ms
    rows = [line.split(",") for line in log_text(clock=1e3).splitlines()[1:]]
    bench.drop("trial-001.csv", head + "\n" + "".join(",".join((r[0], *r[4:])) + "\n" for r in rows))
    assert "clock is in another unit (ms)" in bench.look()
    columns = '["position/hip", "position/knee", "position/ankle"]'
    mapping = f'[channels.position]\ncolumns = {columns}\nlabels = ["hip", "knee", "ankle"]\nunit = "rad"\n'
    bench.drop("mapping.toml", '[time]\ncolumn = "time"\nunit = "ms"\n' + mapping)
    (recording,) = bench.robot.perform(trial())
    assert recording.duration == pytest.approx(DURATION, abs=0.03)


def test_a_log_in_degrees_that_names_no_unit_is_not_taken_and_its_unit_mends_it(bench: Bench) -> None:
    bench.robot.hand_out([trial()])
    lines = log_text(head=("time", *JOINTS, *(f"position/{j}" for j in JOINTS))).splitlines()[1:]
    rows = np.array([[float(cell) for cell in line.split(",")] for line in lines])[:, [0, 4, 5, 6]]
    rows[:, 1:] = np.degrees(rows[:, 1:])
    for unit, taken in (("", False), (" [deg]", True)):
        head = ",".join(["time", *(f"position/{j}{unit}" for j in JOINTS)])
        bench.drop("trial-001.csv", "\n".join([head, *(",".join(f"{v:.6g}" for v in row) for row in rows)]))
        assert "position in degrees; say the unit of the log in mapping.toml" in bench.look()
        assert bool(bench.outcome()) is taken


@pytest.mark.parametrize("begins", [0.3, 0.0])
def test_degrees_show_where_the_robots_own_controller_commands_too(begins: float) -> None:
    start = Channel("position", JOINTS, "rad", np.zeros(1), begins * np.array([[1.0, -0.5, 0.2]]))
    run = replace(trial(), command=None, initial={"position": start})
    moved = start.values + 0.5 * (1.0 - np.cos(TIME))[:, None]

    def logged(values: Array, unit: str) -> Recording:
        return Recording("trial-001", {"position": Channel("position", JOINTS, unit, TIME, values)})

    (said,) = mismatches(run, logged(np.degrees(moved), ""))
    assert "in degrees?; say the unit of the log in mapping.toml" in said
    assert not mismatches(run, logged(moved, ""))
    assert not mismatches(run, logged(moved + 0.1, "rad"))  # placed by hand
    turning = replace(run, initial={})
    assert not mismatches(turning, logged(np.degrees(moved), "rad"))  # wheels turn on and on
    if begins:
        assert "in degrees" in mismatches(run, logged(np.degrees(moved), "rad"))[0]  # as the header had it


def test_a_file_that_is_still_being_written_is_left_until_it_rests(bench: Bench) -> None:
    bench.robot.hand_out([trial()])
    text = log_text()
    bench.inbox.mkdir(exist_ok=True)
    done = threading.Event()

    def write_slowly() -> None:
        with (bench.inbox / "trial-001.csv").open("w") as file:
            for k in range(0, len(text), len(text) // 20):
                file.write(text[k : k + len(text) // 20])
                file.flush()
                time.sleep(0.01)
        done.set()

    writer = threading.Thread(target=write_slowly)
    writer.start()
    while not done.is_set():
        bench.robot.look()
        assert not bench.outcome() or done.is_set()
    writer.join()
    (recording,) = bench.robot.perform(trial())
    assert recording.duration == pytest.approx(DURATION, abs=0.03)


def test_a_file_cut_off_is_refused_and_taken_once_it_is_whole(bench: Bench) -> None:
    bench.robot.hand_out([trial()])
    text = log_text()
    bench.drop("trial-001.csv", text[: len(text) // 2])
    assert "not taken" in bench.look()
    bench.drop("trial-001.csv", text)
    assert len(bench.robot.perform(trial())) == 1


def test_two_runs_at_once_are_not_guessed_between(bench: Bench) -> None:
    bench.robot.hand_out([trial()])
    bench.drop("trial-001.csv", log_text(seed=1))
    bench.drop("trial-001 again.csv", log_text(seed=2))
    assert "leave only what counts" in bench.look()
    assert not bench.outcome()
    (bench.inbox / "trial-001.csv").unlink()
    (recording,) = bench.robot.perform(trial())
    assert recording.provenance["log"] == "trial-001 again.csv"


def test_a_log_that_was_started_early_begins_where_the_run_does(bench: Bench) -> None:
    bench.robot.hand_out([trial()])
    lines = log_text().splitlines()
    still = [f"{t:.3f},{lines[1].partition(',')[2]}" for t in np.arange(0.0, 2.0, 1 / RATE)]
    later = [f"{float(line.split(',')[0]) + 2.0:.3f},{line.partition(',')[2]}" for line in lines[1:]]
    bench.drop("trial-001.csv", "\n".join([lines[0], *still, *later]) + "\n")
    (recording,) = bench.robot.perform(trial())
    assert recording.start == pytest.approx(2.0, abs=0.05)
    assert recording.duration == pytest.approx(DURATION, abs=0.05)


def test_a_log_with_two_runs_in_it_is_said_to_hold_them(bench: Bench) -> None:
    bench.robot.hand_out([trial()])
    lines = log_text().splitlines()
    later = [f"{float(line.split(',')[0]) + DURATION + 1.0:.3f},{line.partition(',')[2]}" for line in lines[1:]]
    bench.drop("trial-001.csv", "\n".join([*lines, *later]) + "\n")
    assert "does it hold two runs" in bench.look()


def test_repeats_are_as_many_logs(bench: Bench) -> None:
    wanted = trial(repeats=2)
    bench.robot.hand_out([wanted])
    bench.drop("trial-001-a.csv", log_text(seed=1))
    bench.look()
    assert not bench.outcome()
    bench.drop("trial-001-b.csv", log_text(seed=2))
    first, second = bench.robot.perform(wanted)
    assert not np.array_equal(first.channel("position").values, second.channel("position").values)


@pytest.mark.parametrize(("word", "error"), [("aborted", TrialAbortedError), ("fell", RobotFellError)])
def test_an_operator_may_say_how_a_run_ended(bench: Bench, word: str, error: type[Exception]) -> None:
    bench.robot.hand_out([trial()])
    bench.drop("trial-001.csv", log_text(seconds=2.0))
    bench.drop(f"trial-001-{word}.txt", "a cable came loose")
    with pytest.raises(error, match="a cable came loose"):
        bench.robot.perform(trial())
    kept = sorted(p.name for p in (bench.accepted / "trial-001" / "set-aside").iterdir())
    assert kept == [f"trial-001-{word}.txt", "trial-001.csv"]
    with pytest.raises(error, match="a cable came loose"):  # the same on the next day
        bench.again().perform(trial())


def test_result_toml_says_it_too(bench: Bench) -> None:
    bench.robot.hand_out([trial(), trial("trial-002")])
    bench.drop("trial-002/result.toml", 'outcome = "fell"\nnote = "into the wall"\n')
    bench.drop("trial-001/result.toml", 'outcome = "fallen"\n')
    assert "'fallen' is not one of: aborted, fell, repeat, done" in bench.look()
    with pytest.raises(RobotFellError, match="into the wall"):
        bench.robot.perform(trial("trial-002"))


def test_a_run_to_be_repeated_does_not_count(bench: Bench) -> None:
    bench.robot.hand_out([trial()])
    bench.drop("trial-001.csv", log_text(seed=1))
    bench.drop("trial-001-repeat.txt", "the battery was low")
    assert "to be run again (the battery was low)" in bench.look()
    assert not bench.outcome()
    bench.drop("trial-001.csv", log_text(seed=2))
    bench.robot.perform(trial())
    assert (bench.accepted / "trial-001" / "set-aside" / "trial-001.csv").read_text() == log_text(seed=1)


def test_the_same_log_is_not_taken_for_two_trials(bench: Bench) -> None:
    bench.robot.hand_out([trial(), trial("trial-002")])
    bench.drop("trial-001.csv", log_text())
    bench.robot.perform(trial())
    bench.drop("trial-002.csv", log_text())
    assert "accepted for trial-001 already" in bench.look()


def test_logs_of_runs_that_look_alike_must_be_named(bench: Bench) -> None:
    runs = [drive("trial-001", 1.0), drive("trial-002", 2.0)]
    bench.robot.hand_out(runs)
    x = np.linspace(0, 8, len(TIME))
    text = "time,position/x,position/y\n" + "".join(
        f"{t:.3f},{a:.4f},{np.sin(a):.4f}\n" for t, a in zip(TIME, x, strict=True)
    )
    bench.drop("log.csv", text)
    assert "could be trial-001 or trial-002: put the right one into its name" in bench.look()
    (bench.inbox / "log.csv").rename(bench.inbox / "log trial-002.csv")
    assert len(bench.robot.perform(runs[1])) == 1


def test_a_log_in_which_no_commanded_joint_moved_is_not_taken() -> None:
    held = Channel("position", JOINTS, "rad", TIME, np.full((len(TIME), 3), 0.3) + 3e-3 * motion())
    (said,) = mismatches(trial(), Recording("run", {"position": held}))
    assert "no joint moved: 'hip' stays within 0.0036 rad, where its command ranges over 1.2 rad: run it again" in said
    one = held.replace(values=np.column_stack([held.values[:, :2], motion()[:, 2]]))
    assert not mismatches(trial(), Recording("run", {"position": one}))


def test_a_joint_that_turns_against_its_command_may_be_logged_with_the_other_sign() -> None:
    alike = motion()[:, [0, 0, 2]] * [1.0, -1.0, 1.0]
    asked = trial().command
    assert asked is not None
    told = replace(trial(), command=asked.replace(values=alike))
    turned = Channel("position", JOINTS, "rad", TIME, alike * [-1.0, 1.0, 1.0])
    (said,) = mismatches(told, Recording("run", {"position": turned}))
    assert "in another order, or 'hip' is logged with the other sign" in said


def test_positions_far_from_the_path_are_another_run(bench: Bench) -> None:
    bench.robot.hand_out([drive("trial-001", 1.0)])
    bench.drop("trial-001.csv", "time,position/x,position/y\n" + "".join(f"{t:.3f},{1e3 * t:.4f},{30}\n" for t in TIME))
    assert "from the path" in bench.look()
    assert "in mm?" in "\n".join(bench.said)


def test_a_robot_that_stood_at_the_start_of_its_path_is_another_run(bench: Bench) -> None:
    bench.robot.hand_out([drive("trial-001", 1.0)])
    bench.drop(
        "trial-001.csv",
        "time,position/x,position/y\n" + "".join(f"{t:.3f},0.001,{1e-3 * np.sin(t):.5f}\n" for t in TIME),
    )
    assert (
        "the robot stood all along: its position stays within 0.002 m, where the path extends over 8.2" in bench.look()
    )
    assert not bench.outcome()


def test_waiting_goes_on_the_next_day(bench: Bench) -> None:
    bench.robot.hand_out([trial(), trial("trial-002")])
    bench.drop("trial-001.csv", log_text(seed=1))
    bench.robot.perform(trial())
    before = (bench.folder / "outbox" / "trial-002" / "README.txt").stat().st_mtime_ns
    bench.drop("trial-002.csv", log_text(seed=2))  # in the night, nobody is looking
    tomorrow = bench.again()
    tomorrow.hand_out([trial("trial-002")])
    assert len(tomorrow.perform(trial("trial-002"))) == 1
    assert len(tomorrow.perform(trial())) == 1  # again, as after an interruption: the same log
    assert (bench.folder / "outbox" / "trial-002" / "README.txt").stat().st_mtime_ns == before


def test_a_log_moved_in_right_before_an_interruption_is_not_lost(bench: Bench) -> None:
    bench.robot.hand_out([trial()])
    bench.drop("trial-001.csv", log_text())
    bench.robot.perform(trial())
    (bench.accepted / "trial-001" / "outcome.json").unlink()  # the outcome was not written any more
    (recording,) = bench.again().perform(trial())
    assert recording.channel("position").labels == JOINTS


def test_a_folder_with_its_own_mapping_and_note_is_one_log(bench: Bench) -> None:
    bench.robot.hand_out([trial()])
    head = ("t", "c1", "c2", "c3", "p1", "p2", "p3")
    bench.drop("trial-001/notes.txt", "windy")
    bench.drop("trial-001/mapping.toml", '[time]\ncolumn = "t"\n[channels.position]\ncolumns = ["p1", "p2", "p3"]\n'
               'labels = ["hip", "knee", "ankle"]\nunit = "rad"\n')  # fmt: skip
    bench.drop("trial-001/run.csv", log_text(head=head))
    (recording,) = bench.robot.perform(trial())
    assert recording.provenance["note"] == "windy"
    shutil.rmtree(bench.inbox)
    assert len(bench.again().perform(trial())) == 1


def car_log(heading: float = 1.0, turned: float = 0.0, steering: float = 1.0) -> tuple[Trial, str]:
    """A car on its path, logged by log-header.csv, with a heading and a steering in other units or from another zero."""
    run = drive("trial-001", 1.0)
    observed = {
        **run.observed, "heading": Observed(("heading",), "rad", TIME),
        "command": Observed(("speed", "steering"), "", TIME),
    }  # fmt: skip
    x = np.linspace(0.0, 8.0, len(TIME))
    shown = np.stack([TIME, x, np.sin(x), turned + heading * np.arctan(np.cos(x)), 1.0 + 0 * x, -steering * np.sin(x)])
    head = "time,position/x,position/y,heading/heading,command/speed,command/steering\n"
    return replace(run, observed=observed), head + "".join(",".join(f"{v:.5f}" for v in row) + "\n" for row in shown.T)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"heading": 57.2958}, ("heading in degrees (unit)", "mapping.toml")),
        ({"heading": -1.0, "turned": np.pi / 2}, ("counted from north",)),
        ({"turned": 1.3}, ("from another zero",)),
        ({"steering": 20.0}, ("steering reaches 20 rad", "in degrees")),
        ({"steering": -1.0}, ("turns to the right where its steering is to the left", "sign = [1, -1]")),
    ],
    ids=["degrees", "compass", "another zero", "steering in degrees", "steering to the right"],
)
def test_angles_of_a_car_that_cannot_be_are_named(
    bench: Bench, changes: dict[str, float], words: tuple[str, ...]
) -> None:
    wanted, right = car_log()
    bench.robot.hand_out([wanted])
    bench.drop("trial-001.csv", car_log(**changes)[1])
    said = bench.look()
    for word in words:
        assert word in said
    assert not bench.outcome()
    bench.drop("trial-001.csv", right)
    assert len(bench.robot.perform(wanted)) == 1


def test_the_operator_is_told_what_is_left_and_how_a_log_was_understood(bench: Bench) -> None:
    bench.robot.hand_out([trial(f"trial-00{k}") for k in (1, 2, 3, 4)])
    assert "trial-001 ... 004" in "\n".join(bench.said)
    bench.drop("trial-002.csv", log_text(seed=2))
    assert "still to run: trial-001, trial-003, trial-004" in bench.look()
    bench.drop("trial-001.csv", log_text(seed=1))
    said = bench.look()
    assert "still to run: trial-003, trial-004" in said
    assert said.count("it was read so: ") == 1
    assert "taken as rad" in said


@pytest.mark.parametrize("seconds", [0.4, 3.0])
def test_a_log_without_values_for_longer_than_can_be_bridged_is_not_taken(bench: Bench, seconds: float) -> None:
    wanted, right = car_log()
    lines = right.splitlines()
    for k in range(100, 100 + round(seconds * RATE)):
        time, _, _, _, *commands = lines[k + 1].split(",")
        lines[k + 1] = ",".join((time, "nan", "nan", "nan", *commands))
    bench.robot.hand_out([wanted])
    bench.drop("trial-001.csv", "\n".join(lines) + "\n")
    said = bench.look()
    assert bench.outcome() == (seconds < 0.5)
    if not bench.outcome():
        assert "'position' and 'heading' have no values from 1.98 to 5 s" in said
        assert "at most 0.5 s can be bridged" in said
        assert "trial-001-aborted.txt" in said


def test_what_is_not_seen_after_a_fall_or_seen_seldom_is_not_missing(bench: Bench) -> None:
    wanted, right = car_log()
    lines = right.splitlines()
    seldom = replace(wanted, observed={"position": wanted.observed["position"]})
    bench.robot.hand_out([seldom])
    bench.drop("trial-001.csv", "\n".join([lines[0], *lines[1::50]]) + "\n")  # one sample a second
    assert len(bench.robot.perform(seldom)) == 1
    after = [",".join((line.split(",")[0], "nan", "nan", "nan", *line.split(",")[4:])) for line in lines[301:]]
    arriving = replace(wanted, name="trial-002", ends=(Left("position", {"x": (-1.0, 5.5)}),))
    bench.robot.hand_out([arriving])
    bench.drop("trial-002.csv", "\n".join([*lines[:301], *after]) + "\n")
    assert len(bench.robot.perform(arriving)) == 1


def test_several_missing_channels_are_one_sentence(bench: Bench) -> None:
    bench.robot.hand_out([car_log()[0]])
    bench.drop("trial-001.csv", "time,temp\n" + "".join(f"{t},20\n" for t in range(9)))
    said = bench.look()
    assert "there is no channel 'position', 'heading' or 'command' in it; it holds temperature: " in said
    assert said.count("it holds") == 1


def test_a_file_that_stays_empty_is_said_to_be_and_is_taken_once_it_is_full(bench: Bench) -> None:
    bench.robot.hand_out([trial()])
    bench.drop("trial-001.csv", "")
    assert "trial-001.csv not taken: it is empty" in bench.look()
    assert "trial-001.csv: it is empty" in (bench.inbox / "problems.txt").read_text()
    assert bench.look().count("it is empty") == 1  # said once
    bench.drop("trial-001.csv", log_text())
    assert len(bench.robot.perform(trial())) == 1


def test_a_mapping_for_all_logs_does_not_stand_in_the_way_of_the_names_of_the_header(bench: Bench) -> None:
    runs = [trial(), trial("trial-002")]
    bench.robot.hand_out(runs)
    head = ("t", "c1", "c2", "c3", "p1", "p2", "p3")
    mapping = (
        '[time]\ncolumn = "t"\n[channels.position]\ncolumns = ["p1", "p2", "p3"]\n'
        'labels = ["hip", "knee", "ankle"]\nunit = "rad"\n'
    )
    bench.drop("mapping.toml", mapping)
    bench.drop("trial-001.csv", log_text(head=head, seed=1))
    assert len(bench.robot.perform(runs[0])) == 1
    rows = [line.split(",") for line in log_text(seed=2).splitlines()[1:]]
    named = "time,position/hip,position/knee,position/ankle\n" + "".join(f"{','.join((r[0], *r[4:]))}\n" for r in rows)
    bench.drop("trial-002/mapping.toml", mapping)  # of this very log: it is to fit
    bench.drop("trial-002/run.csv", named)
    assert "trial-002 not taken: " in bench.look()
    shutil.rmtree(bench.inbox / "trial-002")
    bench.drop("trial-002.csv", named)
    assert bench.robot.perform(runs[1])[0].channel("position").labels == JOINTS
    assert len(bench.again().perform(runs[1])) == 1


def test_a_run_that_its_own_end_cut_short_is_whole_and_the_sheet_says_what_ends_it() -> None:
    time = np.arange(0.0, 40.0, 0.1)
    walk = Trial(
        "trial-001", 0.0, 40.0, None, {"base_position": Observed(("x", "y"), "m", time)},
        ends=(Left("base_position", {"x": (-np.inf, 2.4)}, name="at the line"),),
    )  # fmt: skip

    def walked(speed: float) -> Recording:
        seen = time[time < 18.0]
        place = np.stack([speed * seen, 0.0 * seen], axis=1)
        return Recording("trial-001", {"base_position": Channel("base_position", ("x", "y"), "m", seen, place)})

    assert not mismatches(walk, walked(0.14))
    assert "broken off" in mismatches(walk, walked(0.1))[0]
    assert "at the line: base_position x above 2.4\n" in words(walk, Path("inbox"))


def test_where_a_run_starts_is_said_without_what_settling_leaves_of_zero() -> None:
    start = Channel("position", JOINTS, "rad", np.zeros(1), np.array([[0.5, -6.3e-19, 1e-4]]))
    said = words(replace(trial(), initial={"position": start}), Path("inbox"))
    assert f"Start with position: {JOINTS[0]} 0.5, {JOINTS[1]} 0, {JOINTS[2]} 0.0001 rad\n" in said
