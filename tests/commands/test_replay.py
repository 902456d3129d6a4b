# SPDX-License-Identifier: Apache-2.0
"""`trueup replay`: errors that mean what they say, predictions that know no future, trajectories that can be read again."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from sound_files import ARM, JOINTS, names, signals

from trueup import formats
from trueup.cli import main

NOISE = 1e-3


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("arm.xml").write_text(ARM)
    time, values = signals()
    rows = [",".join(f"{x:.6f}" for x in row) for row in np.column_stack([time, values])]
    Path("log.csv").write_text("\n".join([",".join(["time", *names()]), *rows]) + "\n")
    return tmp_path


def replayed(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, list[float]]:
    assert main(["replay", "arm.xml", "log.csv", "--json", "-q", *words]) == 0
    (found,) = json.loads(capsys.readouterr().out)
    return found


def test_the_true_model_is_as_far_away_as_the_noise_at_every_horizon(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = replayed(capsys)
    assert found["rmse"] == pytest.approx([NOISE] * 2, rel=0.4)
    assert found["mae"] == pytest.approx([NOISE * np.sqrt(2 / np.pi)] * 2, rel=0.4)
    ahead = {round(a["horizon"], 3): a["rmse"] for a in found["ahead"]}  # type: ignore[index]
    assert set(ahead) == {0.01, 0.1, 1.0}
    # The start is known as well as five noisy samples tell it; a second later the servos have forgotten it.
    assert all(NOISE < e < 6 * NOISE for e in ahead[0.01])
    assert all(0.6 * NOISE < e < 2 * NOISE for e in ahead[1.0])


def test_a_prediction_a_second_ahead_sees_what_a_wrong_gain_does_and_the_next_sample_hardly(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    true = replayed(capsys)["ahead"]
    Path("arm.xml").write_text(ARM.replace('kp="6"', 'kp="3"'))
    wrong = replayed(capsys)["ahead"]
    grown = [w["rmse"][0] / t["rmse"][0] for w, t in zip(wrong, true, strict=True)]  # type: ignore[index]
    assert grown[0] < 1.5
    assert grown[2] > 5


def test_commands_that_were_held_are_replayed_worse_by_interpolation(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    held, between = (replayed(capsys, "--commands", how)["rmse"] for how in ("held", "interpolated"))
    assert sum(between) > 2 * sum(held)


def test_a_log_whose_logger_stopped_is_replayed_from_where_the_robot_was_after_it(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    head, *rows = Path("log.csv").read_text().splitlines()
    kept = [row for row in rows if not 1.0 < float(row.split(",")[0]) < 2.5]
    assert 100 < len(kept) < len(rows)
    Path("log.csv").write_text("\n".join([head, *kept]) + "\n")
    for words, parts in (((), 2), (("--refuse", "pauses"), 1)):
        assert main(["replay", "arm.xml", "log.csv", "--json", "-q", *words]) == 0
        found = json.loads(capsys.readouterr().out)
        assert len(found) == parts
        near = max(r["pooled"] for r in found) < 1.5 * NOISE
        assert near == (parts == 2)


def test_trajectories_can_be_read_again(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    time, values = signals()
    for kind in ("csv", "npz", "parquet"):
        assert main(["replay", "arm.xml", "log.csv", "--out", kind, "--trajectories", kind, "-q"]) == 0
        path = Path(kind) / f"log.{kind}"
        if kind == "npz":
            stored = np.load(path)
            measured, simulated = stored["measured/position"], stored["simulated/position"]
        elif kind == "parquet":
            (back,) = formats.read(path)
            measured, simulated = (back.channel(f"{k}/position").values for k in ("measured", "simulated"))
            assert back.channel("measured/position").labels == JOINTS
        else:
            rows = np.genfromtxt(path, delimiter=",", skip_header=1)
            measured, simulated = rows[:, 1:3], rows[:, 3:5]
            assert rows[:, 0] == pytest.approx(time, abs=1e-9)
        np.testing.assert_allclose(measured, values[:, 2:4], atol=2e-6)
        assert np.sqrt(np.mean((simulated - measured) ** 2)) == pytest.approx(NOISE, rel=0.4)
    text = (Path("csv") / "report.html").read_text()
    assert "Next sample" in text
    assert "1 s ahead" in text
    assert "http" not in text.replace("http://www.w3.org", "")
    capsys.readouterr()
