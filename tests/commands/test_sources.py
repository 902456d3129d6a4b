# SPDX-License-Identifier: Apache-2.0
"""What commands read is read in one way, whatever role a recording has."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trueup.commands.sources import given, while_driven
from trueup.errors import MappingError, RecordingError
from trueup.formats import TimeColumn, read
from trueup.recording import Channel, Recording
from trueup.trial import ENABLED


def test_a_rate_counts_for_logs_that_are_held_out_too(tmp_path: Path) -> None:
    logs = [tmp_path / name for name in ("run.csv", "test.csv")]
    for log in logs:
        log.write_text("pos_a,torque_a\n" + "".join(f"{0.1 * k:.1f},{k % 3}\n" for k in range(20)), encoding="utf-8")
    one = argparse.Namespace(recordings=[str(logs[0])], hold_out=[str(logs[1])], mapping=None, model=None)
    fitted, held, _ = given(one, rated=lambda mapping: replace(mapping, time=TimeColumn(rate=50.0)), driven=False)
    assert [r.channel("position").time[-1] for r in (*fitted, *held)] == [pytest.approx(19 / 50)] * 2


def asked(tmp_path: Path, *paths: str, hold_out: Sequence[str] = ()) -> argparse.Namespace:
    for day in ("day_1", "day_2"):
        for name in ("log", "other"):
            file = tmp_path / day / "run" / f"{name}.csv"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(
                "time,pos_a,cmd_a\n" + "".join(f"{0.1 * k:.1f},{k % 3},{k % 5}\n" for k in range(20)), encoding="utf-8"
            )
    return argparse.Namespace(recordings=[str(tmp_path / p) for p in paths], mapping=None, model=None,
                              hold_out=[str(tmp_path / p) for p in hold_out])  # fmt: skip


def test_recordings_whose_files_have_one_name_are_told_apart_by_their_folders(tmp_path: Path) -> None:
    logs = ("day_1/run/log.csv", "day_2/run/log.csv")
    fitted, held, _ = given(asked(tmp_path, *logs, "day_1/run/other.csv", hold_out=logs[1:]))
    assert [r.name for r in fitted] == ["day_1_log", "other"]
    assert [r.name for r in held] == ["day_2_log"]
    fitted, held, _ = given(asked(tmp_path, *logs[:1], hold_out=logs[1:]))
    assert [r.name for r in (*fitted, *held)] == ["day_1_log", "day_2_log"]
    assert [r.name for r in given(asked(tmp_path, logs[0], logs[0]))[0]] == ["log", "log_2"]
    assert [r.name for r in read([tmp_path / p for p in logs])] == ["day_1_log", "day_2_log"]


def test_a_mapping_that_another_log_left_in_the_folder_says_what_to_do_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    args = asked(tmp_path, "day_1/run/log.csv")
    monkeypatch.chdir(tmp_path)
    channels = {"position": "pos_a", "command": "cmd_b"}
    lines = [f'[channels.{role}]\ncolumns = ["{column}"]\n' for role, column in channels.items()]
    Path("mapping.toml").write_text('[time]\ncolumn = "time"\n' + "".join(lines), encoding="utf-8")
    with pytest.raises(
        MappingError, match=r"no column 'cmd_b'.*mapping\.toml in this folder says so: edit it, name another"
    ):
        given(args)
    Path("mapping.toml").rename("other.toml")
    args.mapping = "other.toml"
    with pytest.raises(MappingError) as named:
        given(args)
    assert "in this folder" not in str(named.value)


def test_a_log_of_other_columns_that_is_held_out_is_guessed_and_cut_as_those_that_are_fitted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    args = asked(tmp_path, "day_1/run/log.csv", hold_out=["test.csv"])
    monkeypatch.chdir(tmp_path)
    Path("mapping.toml").write_text(
        '[time]\ncolumn = "time"\n[channels.position]\ncolumns = ["pos_a"]\n', encoding="utf-8"
    )
    rows = [f"{0.1 * k:.1f},{k % 3},{k % 5},{int(k < 12)}\n" for k in range(20)]
    Path("test.csv").write_text("stamp,a_pos,a_cmd,torque_enable\n" + "".join(rows), encoding="utf-8")
    fitted, (held,), notes = given(args)
    assert [r.name for r in fitted] == ["log"]
    assert held.channel("position").labels == ("a",)
    assert held.stop == pytest.approx(1.1)
    assert "mapping.toml names no column of test.csv: theirs are guessed" in notes


def test_each_joint_may_say_whether_its_drive_is_on_and_one_that_never_is_cuts_nothing() -> None:
    time = 0.1 * np.arange(10.0)
    joints = ("a", "b", "c")
    on = np.stack([time > 0.25, time < 0.75, time < 0.0], axis=1).astype(float)
    told = Channel("command", joints, "rad", time, np.zeros((10, 3)))
    log = Recording("log", {"command": told, ENABLED: told.replace(name=ENABLED, unit="", values=on)})
    (kept,), (note,) = while_driven([log])
    assert kept.channel("command").time == pytest.approx(time[3:8])
    assert "cut to 0.30 ... 0.70 s" in note
    off = log.with_channel(log.channel(ENABLED).replace(values=0.0 * on))
    with pytest.raises(RecordingError, match="its drives are off all the time"):
        while_driven([off])
