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
    assert "LinearRegression" in (folder / "out" / "report.html").read_text("utf-8")
    capsys.readouterr()
    assert main(["replay", "arm.xml", "logs/run_4.parquet", "--grounding", "out/grounding.npz", "--json", "-q"]) == 0
    (replay,) = json.loads(capsys.readouterr().out)
    assert replay["pooled"] == pytest.approx(held["after"], rel=0.02)
    assert replay["pooled_against"] == pytest.approx(held["before"], rel=0.02)


def test_what_the_model_lacks_is_found_and_kept(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    given = ["logs/run_0.parquet", "logs/run_1.parquet", "--hold-out", "run_1", "--model", "arm.xml", "--learners", "linear",
             "--history", "3", "--view", "relative", "--residual", "command"]  # fmt: skip
    assert main(["ground", *given, "--out", "delta", "-q"]) == 0
    story = json.loads((folder / "delta" / "grounding.json").read_text("utf-8"))
    assert story["simulator"]["residual"] == "command"
    (held,) = [r for r in story["simulator"]["replays"] if r["kind"] == "held out"]
    assert held["after"] < 0.4 * held["before"]
    assert "added to its commands" in (folder / "delta" / "report.html").read_text("utf-8")


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


def test_the_page_names_all_learners_and_views() -> None:
    rows = re.findall(r"^\| `([\w-]+)` \|", PAGE.read_text("utf-8"), re.MULTILINE)
    assert rows == [*VIEWS_IN_ORDER, *LEARNERS]
    assert set(VIEWS_IN_ORDER) == set(VIEWS)


VIEWS_IN_ORDER = ("plain", "relative", "posed", "own")
