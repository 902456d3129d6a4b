# SPDX-License-Identifier: Apache-2.0
"""`trueup ground` from logs to a grounded simulator, and `trueup replay` with it; its page names what there is."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import servo_problem

from trueup import formats
from trueup.cli import main
from trueup.grounding.learners import LEARNERS
from trueup.grounding.views import VIEWS
from trueup.recording import Channel, Recording

PAGE = Path(__file__).resolve().parents[2] / "docs" / "ground.md"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Logs of soft, late servos, and a model of stiff ones."""
    at, rng = tmp_path_factory.mktemp("ground"), np.random.default_rng(1)
    truth = {**servo_problem.NOMINAL, "kp": 12.0, "delay": 0.03}
    (at / "logs").mkdir()
    for k in range(5):
        formats.write(servo_problem.record(f"run_{k}", truth, rng, 4.0), at / "logs" / f"run_{k}.parquet")
    stiff = {**servo_problem.NOMINAL, "kp": 400.0, "damping": 12.0, "friction": 0.0}
    (at / "arm.xml").write_text(servo_problem.ARM.format(**stiff), encoding="utf-8")
    return at


def test_logs_and_a_model_become_a_grounded_simulator(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    given = [
        "logs",
        "--hold-out",
        "run_4",
        "--model",
        "arm.xml",
        "--learners",
        "linear",
        "--history",
        "4",
        "--view",
        "own",
    ]
    assert main(["ground", *given, "--out", "out", "-q"]) == 0
    story = json.loads((folder / "out" / "grounding.json").read_text("utf-8"))
    (held,) = [r for r in story["simulator"]["replays"] if r["kind"] == "held out"]
    assert held["after"] < 0.85 * held["before"]
    page = (folder / "out" / "report.html").read_text("utf-8")
    assert "LinearRegression" in page
    assert "in a run left out" in page
    assert page.count("measured, and foretold for a second on") == len(story["joints"])
    capsys.readouterr()
    assert main(["replay", "arm.xml", "logs/run_4.parquet", "--grounding", "out/grounding.npz", "--json", "-q"]) == 0
    (replay,) = json.loads(capsys.readouterr().out)
    assert replay["pooled"] == pytest.approx(held["after"], rel=0.02)
    assert replay["pooled_against"] == pytest.approx(held["before"], rel=0.02)
    assert not replay["ahead"], "predictions that begin on the way lack the frames before them"


def test_what_the_model_lacks_is_found_and_kept(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    given = ["logs/run_0.parquet", "logs/run_1.parquet", "--hold-out", "run_1", "--model", "arm.xml", "--learners", "linear",
             "--history", "3", "--view", "relative", "--residual", "command"]  # fmt: skip
    assert main(["ground", *given, "--out", "delta", "-q"]) == 0
    story = json.loads((folder / "delta" / "grounding.json").read_text("utf-8"))
    assert story["simulator"]["residual"] == "command"
    (held,) = [r for r in story["simulator"]["replays"] if r["kind"] == "held out"]
    assert held["after"] < 0.4 * held["before"]
    page = (folder / "delta" / "report.html").read_text("utf-8")
    assert "added to its commands" in page
    assert "in a stretch left out" in page, "one run alone cannot be left out"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--learners", "modeltree"], "did you mean 'model-tree'"),
        (["--view", "all"], "views are: own, plain, posed, relative"),
        (["--joints", "elbw"], "did you mean 'elbow'"),
        (["--others", "com"], "channel 'com'"),
        (["--share", "3"], "a share of 0 to 1"),
        (["--budget", "-5"], "--budget -5: a number above 0 is needed"),
        (["--budget", "nan"], "--budget nan: a number above 0 is needed"),
        (["--budget", "1e-9"], "was done; give the comparison a larger budget"),
        (["--residual", "torque"], "say which with --model"),
        (["--history", "0"], "a history of 0 frames"),
        (["--hold-out", "*"], "none is left"),
    ],
)
def test_what_cannot_be_is_said(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], given: list[str], said: str
) -> None:
    monkeypatch.chdir(folder)
    assert main(["ground", "logs", *given, "--out", "none", "-q"]) == 1
    assert said in " ".join(capsys.readouterr().err.split())
    assert not (folder / "none").exists()


def swinging(name: str, seed: int, *, size: float = 0.5) -> Recording:
    """A joint that follows late, one that is told nothing and stands still, and the accelerometer of a base that is held."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 8.0, 0.01)
    asked = size * np.sin(2.0 * np.pi * 0.5 * t + seed) + 0.5 * size * np.sin(2.0 * np.pi * 0.8 * t)
    went = np.zeros_like(asked)
    for k in range(1, len(t)):
        went[k] = went[k - 1] + 0.15 * (asked[k - 1] - went[k - 1])
    position = np.column_stack([went, np.full_like(t, 0.3)]) + rng.normal(0.0, 5e-4, (len(t), 2))
    channels = {
        "command": Channel("command", ("lift", "wrist"), "rad", t, np.column_stack([asked, np.full_like(t, 0.3)])),
        "position": Channel("position", ("lift", "wrist"), "rad", t, position),
        "accel": Channel("accel", ("x", "y", "z"), "m/s^2", t, rng.normal([0.0, 0.0, 9.81], 0.05, (len(t), 3))),
    }
    return Recording(name, channels)


def test_missing_commands_are_held_and_counted_and_what_stands_still_counts_in_no_average(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for k in range(3):
        whole = swinging(f"run_{k}", k)
        command = whole.channel("command")
        values = np.where(np.random.default_rng(k).random(command.values.shape) < 0.3, np.nan, command.values)
        formats.write(whole.with_channel(command.replace(values=values)), tmp_path / "holes" / f"run_{k}.parquet")
        formats.write(whole, tmp_path / "whole" / f"run_{k}.parquet")
    told = {}
    for name in ("holes", "whole"):
        out = tmp_path / f"out_{name}"
        assert main(["ground", str(tmp_path / name), "--learners", "linear", "--out", str(out)]) == 0
        told[name] = json.loads((out / "grounding.json").read_text("utf-8"))
    said = capsys.readouterr()
    assert re.search(r"of 4800 values of commands are missing: the one sent before is held", " ".join(said.err.split()))
    assert "wrist stands still in all 3 recordings" in " ".join(said.err.split())
    frames = {name: story["frames"] for name, story in told.items()}
    assert frames["holes"] == frames["whole"]
    lift, wrist = told["whole"]["learners"][0]["by_run"]["rae"]
    assert lift < 0.05
    assert wrist is None
    assert "stands still" in (tmp_path / "out_whole" / "report.html").read_text("utf-8")
    assert f"{100.0 * lift:.2f}" in said.out  # the average is of what moves
    assert not re.search(r"\b1 frames", said.out + (tmp_path / "out_whole" / "report.html").read_text("utf-8"))
    assert told["whole"]["others"] == {}
    assert not any("accel" in each["inputs"] for each in told["whole"]["tried"])
    assert any("'accel' does not go in" in note for note in told["whole"]["notes"])


def test_nothing_is_learned_where_no_joint_moves(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole = swinging("run", 0)
    joints = {name: whole.channel(name).select(["wrist"]) for name in ("command", "position")}
    formats.write(whole.replace(channels=joints), tmp_path / "run.parquet")
    assert main(["ground", str(tmp_path / "run.parquet"), "--learners", "linear", "--out", str(tmp_path / "out")]) == 1
    assert "no joint that is commanded moves in any of 1 recording: wrist" in " ".join(capsys.readouterr().err.split())


def test_a_refused_run_is_named_beside_the_others(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    given = ["--model", "arm.xml", "--learners", "linear", "--share", "0.3", "--no-inverse"]
    assert main(["ground", "logs", *given, "--out", "narrow", "-q"]) == 0
    (usual,) = formats.read([folder / "logs" / "run_3.parquet"])
    command = usual.channel("command")
    wild = usual.with_channel(command.replace(values=command.values + np.array([0.0, 4.0])))
    formats.write(wild.replace(name="wild"), folder / "wild.parquet")
    capsys.readouterr()
    both = ["replay", "arm.xml", "logs/run_3.parquet", "wild.parquet", "--grounding", "narrow/grounding.npz"]
    assert main([*both, "--json", "-q", "--out", "narrow_replay"]) == 1
    told = capsys.readouterr()
    shown, failed = json.loads(told.out)
    assert (shown["recording"], failed["recording"]) == ("run_3", "wild")
    assert "error not replayed: 'wild': refused after" in " ".join(told.err.split())
    page = (folder / "narrow_replay" / "report.html").read_text("utf-8")
    assert "not replayed: &#x27;wild&#x27;: refused after" in page
    assert "without grounding" in page


def test_a_held_out_run_of_other_joints_is_named_before_anything_is_learned(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    formats.write(swinging("other", 0), folder / "other.parquet")
    assert main(["ground", "logs", "--hold-out", "other.parquet", "--budget", "1e-9", "--out", "none", "-q"]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "recording 'other' has no position of shoulder" in said
    assert "it has position of lift, wrist" in said


def test_a_joint_of_the_other_sign_is_said_to_be(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for k in range(2):
        t = np.arange(0.0, 6.0, 0.02)
        pan, tilt = np.sin(2.0 * t + k), 0.5 * np.sin(3.0 * t + k)
        rows = np.column_stack([t, pan, tilt, pan, -tilt])
        head = "time,command_pan,command_tilt,pan,tilt"
        np.savetxt(tmp_path / f"run_{k}.csv", rows, delimiter=",", header=head, comments="")
    assert main(["ground", str(tmp_path), "--learners", "linear", "--out", str(tmp_path / "out")]) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "command of tilt is about -1 times position" in said
    assert "sign = [1, -1] for one of the two" in said


def test_a_file_that_is_no_grounding_is_named(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    assert main(["ground", "logs", "--learners", "linear", "--out", "kept", "-q"]) == 0
    whole = (folder / "kept" / "grounding.npz").read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 3] ^= 0xFF
    for name, content in (("cut.npz", whole[:3000]), ("text.npz", b"hello\n"), ("flipped.npz", bytes(flipped))):
        (folder / name).write_bytes(content)
        capsys.readouterr()
        assert main(["replay", "arm.xml", "logs/run_0.parquet", "--grounding", name, "-q"]) == 1
        said = " ".join(capsys.readouterr().err.split())
        assert f"{name} is no grounding as `trueup ground` writes it" in said
        assert "pickle" not in said
    assert main(["replay", "arm.xml", "logs/run_0.parquet", "--grounding", "kept", "-q"]) == 1
    assert "it is a folder" in capsys.readouterr().err


def test_a_simulator_that_does_not_show_a_channel_is_grounded_without_it(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    for k in range(2):
        (run,) = formats.read([folder / "logs" / f"run_{k}.parquet"])
        load = Channel("load", ("tip",), "", run.time, np.sin(run.time + k))
        formats.write(run.with_channel(load), folder / "loaded" / f"run_{k}.parquet")
    given = ["ground", "loaded", "--model", "arm.xml", "--learners", "linear", "--share", "0.3", "--no-inverse"]
    assert main([*given, "--out", "unloaded"]) == 0
    assert "does not show it to controllers: load" in " ".join(capsys.readouterr().err.split())
    assert main([*given, "--others", "load", "--out", "none", "-q"]) == 1
    assert "channel 'load'" in capsys.readouterr().err


def test_the_page_names_all_learners_and_views() -> None:
    rows = re.findall(r"^\| `([\w-]+)` \|", PAGE.read_text("utf-8"), re.MULTILINE)
    assert rows == [*VIEWS_IN_ORDER, *LEARNERS]
    assert set(VIEWS_IN_ORDER) == set(VIEWS)


VIEWS_IN_ORDER = ("plain", "relative", "posed", "own")
