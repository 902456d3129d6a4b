# SPDX-License-Identifier: Apache-2.0
"""The examples run, and do what they say."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from trueup.campaign.history import History
from trueup.campaign.journal import read_journal
from trueup.studies.servo_arm.demo import record

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two short recordings of the stand-in arm: enough to see that an example works."""
    folder = tmp_path_factory.mktemp("recordings")
    record(folder)
    for name in ("slow_ramps", "waypoints", "pick_and_place", "sinusoids"):
        (folder / f"{name}.csv").unlink()
    for path in folder.glob("*.csv"):
        path.write_text("".join(path.read_text("utf-8").splitlines(keepends=True)[:100]), encoding="utf-8")
    return folder


def test_there_are_examples() -> None:
    assert EXAMPLES


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short(path: Path) -> None:
    assert len(path.read_text("utf-8").splitlines()) <= 100


def test_a_cart_pole_of_ones_own_is_short_and_tuned_by_a_campaign(tmp_path: Path) -> None:
    """An own engine, quantity, controller, task and robot: a length that is wrong is found, the swing gets higher."""
    folder = ROOT / "examples" / "cart_pole"
    assert sum(len(p.read_text("utf-8").splitlines()) for p in folder.iterdir() if p.is_file()) < 200
    own = Path(shutil.copytree(folder, tmp_path / "cart_pole")) / "campaign.toml"
    much = own.read_text("utf-8")
    for of_it, enough in (
        ("rounds = 2", "rounds = 1"),
        ("evaluations = 60", "evaluations = 30"),
        ("samples = 4", "samples = 2"),
    ):
        assert of_it in much
        much = much.replace(of_it, enough)
    own.write_text(much, encoding="utf-8")
    run = ["run", str(own), "--out", str(tmp_path / "out"), "--yes"]
    command = [sys.executable, "-m", "trueup.cli", *run]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    history = History.of(read_journal(tmp_path / "out"))
    assert history.best[1] < 0.2 * history.first_score
    fitted = history.rounds[-1].calibrated
    assert fitted is not None
    k = fitted.names.index("pole.length")
    assert fitted.low[k] < 0.6 < fitted.high[k]
    assert fitted.values[k] == pytest.approx(0.6, rel=0.05)


def test_the_calibration_example_lowers_the_held_out_error(recordings: Path) -> None:
    command = [sys.executable, str(ROOT / "examples" / "calibrate_arm.py"), str(recordings)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    numbers = re.search(r"held out \(steps\): ([\d.]+) -> ([\d.]+) mrad", done.stdout)
    assert numbers, done.stdout
    assert float(numbers[2]) < 0.5 * float(numbers[1])
    assert (recordings / "report.html").is_file()


def test_the_tuning_example_makes_the_robot_better(tmp_path: Path) -> None:
    """With fewer vehicles and candidates than it has."""
    text = (ROOT / "examples" / "tune_gains.py").read_text("utf-8")
    for much, enough in ((".sample(8", ".sample(3"), ("evaluations=120", "evaluations=40")):
        assert much in text
        text = text.replace(much, enough)
    (tmp_path / "tune_gains.py").write_text(text, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, str(tmp_path / "tune_gains.py")], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    numbers = re.search(r"robot: ([\d.]+) -> ([\d.]+) mm", done.stdout)
    assert numbers, done.stdout
    assert float(numbers[2]) < 0.7 * float(numbers[1])
