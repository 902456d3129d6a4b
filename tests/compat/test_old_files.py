# SPDX-License-Identifier: Apache-2.0
"""Files that an earlier version wrote are read as they were meant: what a user has kept is never lost to a new layout."""

from __future__ import annotations

import io
import json
import math
import re
import shutil
import tomllib
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from trueup.campaign.events import Calibrated, Ended, Scored
from trueup.campaign.folder import Folder
from trueup.campaign.history import History
from trueup.campaign.journal import Journal, read_journal
from trueup.campaign.plan import read_plan
from trueup.cli import main
from trueup.commands.status import show_status
from trueup.engines.vehicle.kernels import steered
from trueup.engines.vehicle.vehicle_file import read_vehicle
from trueup.formats import ChannelMap
from trueup.loop.prepare import simulator_for

FILES = Path(__file__).parent / "files"
ARM = Path(str(resources.files("trueup") / "studies" / "servo_arm" / "arm.xml"))


def test_the_journal_of_a_finished_campaign_is_read_line_by_line() -> None:
    events = read_journal(FILES / "campaign")
    lines = (FILES / "campaign" / "journal.jsonl").read_text().splitlines()
    assert [type(e).__name__ for e in events] == [json.loads(line)["event"] for line in lines]
    (fitted,) = [e for e in events if isinstance(e, Calibrated)]
    written = next(plain for line in lines if (plain := json.loads(line))["event"] == "Calibrated")
    assert fitted.names == tuple(written["names"])
    np.testing.assert_array_equal(fitted.values, written["values"])
    assert isinstance(events[-1], Ended)


def test_the_story_of_an_old_campaign_is_told_with_its_best_settings() -> None:
    folder = Folder.open(FILES / "campaign")
    out = io.StringIO()
    history = History.of(read_journal(folder.path))
    show_status(history, folder.file.plan, Console(file=out, width=120))
    scores = [s for e in read_journal(folder.path) if isinstance(e, Scored) for s in e.scores]
    _settings, best = history.best
    assert best <= np.nanmin(scores) * 1.1  # the mean of the best candidate's runs
    assert "k1 = " in out.getvalue()


def test_an_old_journal_can_be_written_on(tmp_path: Path) -> None:
    shutil.copytree(FILES / "campaign", tmp_path / "c")
    with Journal(tmp_path / "c") as journal:
        assert len(journal.past) == len(read_journal(FILES / "campaign"))


@pytest.mark.parametrize("plan", [FILES / "campaign" / "plan.toml", FILES / "blank.toml"], ids=["stanley", "blank"])
def test_an_old_plan_is_read(plan: Path) -> None:
    assert read_plan(plan).plan.name == tomllib.loads(plan.read_text())["name"]


def test_an_old_mapping_is_read_and_maps_the_same_columns() -> None:
    mapping, plain = ChannelMap.load(FILES / "mapping.toml"), tomllib.loads((FILES / "mapping.toml").read_text())
    for name, table in plain["channels"].items():
        assert list(mapping.channels[name].columns) == table["columns"]
        assert mapping.channels[name].unit == table["unit"]


def test_an_old_parameter_file_starts_a_simulator_from_its_values() -> None:
    plain = tomllib.loads((FILES / "parameters.toml").read_text())["parameter"]
    simulator, _notes = simulator_for(ARM, [], FILES / "parameters.toml")
    assert len(simulator.parameters) == len(plain)
    np.testing.assert_allclose(simulator.parameters.nominal, [p["nominal"] for p in plain])
    np.testing.assert_array_equal(simulator.parameters.free, [not p.get("frozen", False) for p in plain])


def test_an_old_car_is_described_with_its_values(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "none.csv").write_text("t,x\n0,0\n")
    assert main(["replay", str(FILES / "car.toml"), str(tmp_path / "none.csv")]) == 1
    error = re.sub(r"\s+", " ", capsys.readouterr().err)
    assert "none" in error  # the car is understood; it is the drive that holds nothing
    assert "vehicle" not in error


def test_an_old_car_by_throttle_turns_and_is_tracked_as_it_did() -> None:
    old = tomllib.loads((FILES / "car.toml").read_text())["vehicle"]["values"]
    car = read_vehicle(FILES / "car.toml")
    assert car.values["pose_at"] * car.wheelbase == pytest.approx(
        old["pose_ahead"] + old["weight_in_front"] * car.wheelbase
    )
    for command in (0.2, 0.6, 1.0):  # its wheels turned it by what stood for their angle, and now do by the tangent
        turned_by = old["steering_left"] * command * (1.0 - old["steering_bend"] * command**2)
        assert math.tan(steered(car.row, command)) == pytest.approx(turned_by, rel=0.02)
