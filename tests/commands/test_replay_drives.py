# SPDX-License-Identifier: Apache-2.0
"""A car's file is judged on drives as it is: the truth predicts them, a wrong car does not, and both stand side by side."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from trueup.cli import main
from trueup.engines.vehicle import Vehicle, VehicleSimulator
from trueup.engines.vehicle.family import said_once
from trueup.engines.vehicle.vehicle_file import write_vehicle
from trueup.recording import Channel
from trueup.trial import Observed, Trial

TRUTH = Vehicle(
    "truth",
    0.3,
    drive="throttle",
    values={"steering_left": 0.4, "steering_right": 0.4, "drive": 8.0, "friction": 0.5, "speed_loss": 1.0},
)


@pytest.fixture
def drives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two drives of a known car as CSV files; the files of that car, of a wrong one, and of one of which nothing is known."""
    monkeypatch.chdir(tmp_path)
    write_vehicle(TRUTH, Path("truth.toml"))
    write_vehicle(
        replace(TRUTH, values={**TRUTH.values, "steering_left": 0.5, "steering_right": 0.5}), Path("wrong.toml")
    )
    Path("bare.toml").write_text("[vehicle]\nwheelbase = 0.3\n")
    for k in range(2):
        time = np.arange(0.0, 24.0, 0.02)
        steering = 0.8 * np.sin(0.7 * time + k) * np.cos(0.17 * time)
        command = Channel("command", ("throttle", "steering"), "", time, np.stack([0.35 + 0 * time, steering], axis=1))
        still = np.arange(-0.5, 1.3, 0.02)
        start = {
            "position": Channel("position", ("x", "y"), "m", still, np.zeros((len(still), 2))),
            "heading": Channel("heading", ("heading",), "rad", still, np.zeros(len(still))),
        }
        seen = {"position": Observed(("x", "y"), "m", time[50:]), "heading": Observed(("heading",), "rad", time[50:])}
        (run,) = VehicleSimulator(TRUTH, horizon=1e3).rollout(
            [Trial("t", 1.0, 23.0, command, seen, start)], np.zeros((1, 0))
        )
        x, y = run.channels["position"][0].T
        table = np.column_stack([time[50:], command.values[50:], x, y, run.channels["heading"][0]])
        np.savetxt(
            f"drive_{k}.csv", table, delimiter=",", header="time,throttle,steering,x,y,yaw", comments="", fmt="%.7f"
        )
    return tmp_path


def test_the_truth_predicts_its_drives_and_a_wrong_car_does_not(
    drives: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = ["drive_0.csv", "drive_1.csv"]
    assert main(["replay", "truth.toml", *files, "--against", "wrong.toml", "--json", "-q"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [f["recording"] for f in found] == ["drive_0", "drive_1"]
    for one in found:
        assert one["ahead"][1]["horizon"] == 3.0
        assert one["ahead"][1]["mean"] < 0.02 < 0.1 < one["ahead_against"][1]["mean"]
        assert one["moved"] > 2.0


def test_a_predicted_drive_is_shown_and_drawn(drives: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", "bare.toml", "drive_0.csv", "--out", "shown"]) == 0
    said = capsys.readouterr()
    assert "in 3 s" in said.out
    assert "holds no [vehicle.values]" in said.err
    ElementTree.parse("shown/drive_0.svg")
    assert main(["replay", "truth.toml", "drive_0.csv", "--parameters", "p.toml"]) != 0
    assert "[vehicle.values]" in capsys.readouterr().err
    assert main(["replay", "truth.toml", "drive_0.csv", "--against", "arm.xml"]) != 0
    assert "another car's TOML file" in capsys.readouterr().err


def test_what_is_said_of_many_drives_is_said_once() -> None:
    said = said_once(["'a': no heading", "'b': a gap", "'c': no heading", "'d': no heading", "all: fine"])
    assert said == ("'a' and 2 more: no heading", "'b': a gap", "all: fine")
