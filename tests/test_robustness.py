# SPDX-License-Identifier: Apache-2.0
"""Whatever is wrong with the files, a command says it in words; the benchmark with this name tries ten thousand cases."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from robustness import KINDS, run_case
from sound_files import MAPPING, names, write_sound

from trueup.cli import main


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("files") / "sound"
    write_sound(folder)
    return folder


@pytest.fixture
def here(sound: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for file in sound.iterdir():
        if file.is_file():
            (tmp_path / file.name).write_bytes(file.read_bytes())
    return tmp_path


def said(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    code = main(list(words))
    text = capsys.readouterr()
    return code, " ".join((text.out + text.err).split())


def test_damaged_files_end_in_words_and_altered_journals_are_not_believed(sound: Path) -> None:
    seed = int.from_bytes(os.urandom(4)) if os.environ.get("TRUEUP_FUZZ") else 1
    cases = [run_case(seed, number, sound) for number in range(60)]
    assert {str(c["kind"]) for c in cases} == set(KINDS)
    assert [c for c in cases if c["wrong"] or c["slow"] or c["silent"]] == []


def test_what_is_no_file_is_refused_behind_links_too(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    os.mkfifo("pipe.csv")
    Path("link.csv").symlink_to("pipe.csv")
    Path("zero.csv").symlink_to("/dev/zero")
    for name, what in (
        ("pipe.csv", "it is a pipe"),
        ("link.csv", "a pipe behind a link"),
        ("zero.csv", "a device behind a link"),
    ):
        code, text = said(capsys, "inspect", name)
        assert code == 1
        assert what in text
    for option in (["calibrate", "link.csv", "log.csv"], ["inspect", "log.csv", "--mapping", "pipe.csv"],
                   ["calibrate", "arm.xml", "log.csv", "--parameters", "link.csv"], ["run", "pipe.csv"]):  # fmt: skip
        code, text = said(capsys, *option)
        assert (code, "a pipe" in text) == (1, True), text


def test_names_in_files_cannot_move_the_cursor(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    head = "time,foo\x1b[2Jbar,\u202ebaz"
    Path("log.csv").write_text("\n".join([head, *(f"{k / 100},{k % 7},{k % 11}" for k in range(50))]) + "\n")
    for words in (["inspect", "log.csv"], ["inspect", "log.csv", "--json"]):
        code, text = said(capsys, *words)
        assert code == 0
        assert "\x1b" not in text
        assert "\u202e" not in text
        assert "x1b" in text or "u001b" in text
        Path("mapping.toml").unlink(missing_ok=True)


def test_a_mapping_is_used_only_for_files_that_it_fits_and_errors_name_it(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("mapping.toml").write_text(MAPPING)
    code, text = said(capsys, "inspect", "log.csv", "foreign.parquet")
    assert code == 0
    assert "mapping.toml names no column of foreign.parquet: theirs are guessed" in text
    code, text = said(capsys, "inspect", "foreign.parquet", "--mapping", "mapping.toml")
    assert code == 1, "one that was named is meant"
    Path("mapping.toml").write_text(MAPPING.replace("cmd_wrist", "cmd_wrst"))
    code, text = said(capsys, "inspect", "log.csv")
    assert code == 1
    assert "columns are read as mapping.toml says" in text
    assert "cmd_wrst" in text


def test_two_samples_and_impossible_rates_are_errors_and_empty_columns_are_said(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    head, *rows = Path("log.csv").read_text().splitlines()
    Path("two.csv").write_text("\n".join([head, *rows[:2]]) + "\n")
    assert "2 samples; at least 3" in said(capsys, "inspect", "two.csv")[1]
    fast = [",".join([repr(i * 1e-300), *row.split(",")[1:]]) for i, row in enumerate(rows)]
    Path("fast.csv").write_text("\n".join([head, *fast]) + "\n")
    code, text = said(capsys, "inspect", "fast.csv")
    assert code == 1
    assert "samples per second" in text
    empty = [row.rpartition(",")[0] + "," for row in rows]
    Path("empty.csv").write_text("\n".join([head, *empty]) + "\n")
    assert f"nothing at all stands in column {names()[-1]}" in said(capsys, "inspect", "empty.csv")[1]


def test_thousands_of_columns_are_no_error(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    values = np.random.default_rng(0).normal(size=(5, 3_000))
    head = ",".join(["time", *(f"extra_{i}" for i in range(values.shape[1]))])
    rows = [f"{k / 100}," + ",".join(f"{x:.3f}" for x in row) for k, row in enumerate(values)]
    Path("wide.csv").write_text("\n".join([head, *rows]) + "\n")
    code, text = said(capsys, "inspect", "wide.csv")
    assert code == 0
    assert "3000 x unit unknown" in text


def test_a_dry_run_says_what_would_be_done_and_leaves_nothing(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {p.name for p in here.iterdir()}
    code, text = said(capsys, "calibrate", "arm.xml", "log.csv", "--parameters", "kp.toml", "--dry-run")
    assert code == 0
    assert "hinge.kp N m/rad 6 1 40" in text
    code, text = said(capsys, "run", "plan.toml", "--dry-run")
    assert code == 0, text
    assert "swing, centre" in text
    assert {p.name for p in here.iterdir()} - {"__pycache__"} == before


def test_an_altered_plan_or_origin_of_a_campaign_is_said(
    sound: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for file, change in (("plan.toml", ("rounds = 1", "rounds = 2")), ("origin.json", ('"seed": 3', '"seed": 4'))):
        folder = tmp_path / file
        shutil.copytree(sound / "campaign", folder)
        (folder / file).write_text((folder / file).read_text().replace(*change))
        code, text = said(capsys, "status", str(folder))
        assert code == 1
        assert "altered" in text
    assert set(json.loads((sound / "campaign" / "origin.json").read_text())) == {"plan", "seed", "check"}
    (folder / "origin.json").write_text('{"plan": "plan.toml", "seed": 1e999}')
    code, text = said(capsys, "status", str(folder))
    assert code == 1
    assert "not a campaign's folder" in text
