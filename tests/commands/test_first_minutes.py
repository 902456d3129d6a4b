# SPDX-License-Identifier: Apache-2.0
"""The first ten minutes: what was mistyped is guessed, the machine is looked at, the shell completes."""

from __future__ import annotations

import io
import json
import shutil
import subprocess
from pathlib import Path

import pytest
from rich.console import Console

from trueup.cli import main
from trueup.commands.sources import recordings_in


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["inspekt", "x.csv"], "inspect"),
        (["replay", "a.xml", "b.csv", "--agianst=c.xml"], "--against"),
        (["calibrate", "a.xml", "b.csv", "--search", "gradiant"], "gradient"),
        (["run", "--dry-rnu"], "--dry-run"),
    ],
)
def test_what_was_probably_meant_is_said(words: list[str], meant: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 2
    assert f"did you mean '{meant}'?" in capsys.readouterr().err


def test_the_nearest_file_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("multisine.csv").write_text("time,q1\n0,1\n")
    assert main(["inspect", "multisin.csv"]) == 1
    assert "did you mean 'multisine.csv'?" in capsys.readouterr().err
    assert main(["run", "campain.toml"]) == 1
    Path("robot.xml").write_text("<mujoco/>")
    assert main(["replay", "robo.xml", "multisine.csv"]) == 1


def test_the_doctor_finds_what_a_working_installation_needs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "4")
    assert main(["doctor", "--json"]) == 0
    found = {f["what"]: f for f in json.loads(capsys.readouterr().out)}
    assert {"Python", "packages", "extra", "threads", "speed", "rendering", "browser"} <= set(found)
    assert found["packages"]["verdict"] == "good"
    assert found["threads"]["verdict"] == "mind", "several threads for small matrices"


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
def test_bash_completes_commands_and_options(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "bash"]) == 0
    script = capsys.readouterr().out
    asked = """
COMP_WORDS=(trueup {0}); COMP_CWORD={1}; _trueup; echo "${{COMPREPLY[@]}}"
"""
    said = subprocess.run(
        ["bash", "-c", script + asked.format("cal", 1) + asked.format("replay --tr", 2)],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split("\n")
    assert said[:2] == ["calibrate", "--trajectories"]
    for shell in ("zsh", "fish"):
        assert main(["completion", shell]) == 0
        assert "calibrate" in capsys.readouterr().out


def test_long_files_are_read_with_a_bar_on_a_terminal(tmp_path: Path) -> None:
    path = tmp_path / "long.csv"
    path.write_text("time,q1,q2\n" + "".join(f"{k / 1000:.3f},{k % 97},{k % 89}\n" for k in range(400_000)))
    terminal = Console(file=io.StringIO(), force_terminal=True, width=100)
    (recording,), notes = recordings_in([path], None, terminal, named=False)
    assert isinstance(terminal.file, io.StringIO)
    assert "reading long.csv" in terminal.file.getvalue()
    assert len(recording.channel("position").time) == 400_000
    assert notes == []


def test_what_is_missing_is_said_with_what_belongs_in_which_place(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "log.csv", "--out", "fit"]) == 2
    said = capsys.readouterr().err
    assert "MODEL (MJCF or URDF of the robot, or TOML of a car), then RECORDING (files or folders)" in said


def test_inspect_leaves_a_mapping_in_which_a_clock_can_be_mended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("log.csv").write_text("time,q1\n" + "".join(f"{1 - k / 100:.2f},{k}\n" for k in range(100)))
    assert main(["inspect", "log.csv"]) == 1
    assert "which was written with what could be guessed" in " ".join(capsys.readouterr().err.split())
    text = Path("mapping.toml").read_text()
    Path("mapping.toml").write_text(text.replace('# repair = "sort"', 'repair = "sort"'))
    assert main(["inspect", "log.csv"]) == 0
