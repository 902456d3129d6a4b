# SPDX-License-Identifier: Apache-2.0
"""A mapping says how columns become channels: what it says is done, and what it cannot mean is refused by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from trueup import formats
from trueup.errors import ClockError, FormatError, MappingError, OutputError, UnknownNameError
from trueup.formats import ChannelColumns, ChannelMap, TimeColumn
from trueup.recording import Recording

LOG = "t_ms,cmd_hip,cmd_knee,pos_hip,pos_knee,raw\n" + "".join(
    f"{10 * i},{i},{-i},{90 + i},{45 - i},{2048 + i}\n" for i in range(30)
)


def read(folder: Path, data: dict[str, Any], text: str = LOG) -> Recording:
    (folder / "log.csv").write_text(text)
    (recording,) = formats.read(folder / "log.csv", ChannelMap.from_dict(data))
    return recording


def mapped(**channel: Any) -> dict[str, Any]:
    return {"time": {"column": "t_ms", "unit": "ms"}, "channels": {"position": channel}}


def test_patterns_take_columns_in_order_and_label_them_by_joint(tmp_path: Path) -> None:
    position = read(tmp_path, mapped(columns="pos_*", unit="deg")).channel("position")
    assert position.labels == ("hip", "knee")
    assert position.unit == "rad"
    assert position.values[0] == pytest.approx(np.deg2rad([90.0, 45.0]))
    assert position.time[:3] == pytest.approx([0.0, 0.01, 0.02])


def test_scale_offset_and_sign_act_in_that_order_for_each_column(tmp_path: Path) -> None:
    columns = ["pos_hip", "pos_knee"]
    changed = mapped(columns=columns, unit="deg", scale=[2.0, 1.0], offset=[-180.0, 5.0], sign=[-1, 1])
    assert read(tmp_path, changed).channel("position").values[10] == pytest.approx(np.deg2rad([-20.0, 40.0]))


def test_encoder_ticks_become_radians_by_scale(tmp_path: Path) -> None:
    ticks = mapped(columns="raw", labels=["hip"], unit="rad", scale=2 * np.pi / 4096, offset=-np.pi)
    position = read(tmp_path, ticks).channel("position")
    assert position.labels == ("hip",)
    assert position.values[:2, 0] == pytest.approx([0.0, 2 * np.pi / 4096])


def test_joints_are_renamed_in_all_channels(tmp_path: Path) -> None:
    data: dict[str, Any] = mapped(columns="pos_*") | {"joints": {"hip": "FL_hip_joint"}}
    data["channels"]["command"] = {"columns": "cmd_*"}
    recording = read(tmp_path, data)
    assert {channel.labels for channel in recording.channels.values()} == {("FL_hip_joint", "knee")}
    with pytest.raises(UnknownNameError, match=r"joint 'elbow' is not in .*hip, knee"):
        read(tmp_path, data | {"joints": {"elbow": "x"}})


def test_a_rate_stands_for_a_missing_time(tmp_path: Path) -> None:
    data = {"time": {"rate": 250.0}, "channels": {"position": {"columns": "pos_hip"}}}
    assert np.diff(read(tmp_path, data).time) == pytest.approx(0.004)


def test_a_time_that_lost_its_digits_is_named(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("timestamp,q_hip\n1.7E+09,0.1\n1.7E+09,0.2\n1.7E+09,0.3\n")
    with pytest.raises(MappingError, match="timestamp is 1700000000 in all rows: were digits lost"):
        formats.read(tmp_path / "log.csv")


def test_files_of_one_run_whose_clocks_count_from_different_instants_are_named_with_both(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    tag = "".join(f"{5.3 + k / 15:.3f},{k}\n" for k in range(60))
    wheels = "".join(f"{1722000000 + k / 50:.2f},{k},{k}\n" for k in range(200))
    (run / "tag.csv").write_text("t,base_x\n" + tag)
    (run / "wheels.csv").write_text("stamp,cmd_left,pos_left\n" + wheels)
    with pytest.raises(ClockError, match=r"from 5.3 to 9.233 s, that of wheels.csv from 1722000000 .*time_offset"):
        formats.read([run])
    (run / "tag.csv").write_text("t,base_x\n" + "".join(f"{1722000003.5 + k / 15:.3f},{k}\n" for k in range(60)))
    assert formats.read([run])[0].duration == pytest.approx(7.433, abs=0.01), (
        "what hangs over at an end is no other clock"
    )


def test_a_second_clock_in_the_same_rows_is_brought_to_the_first(tmp_path: Path) -> None:
    """A 10 Hz clock with another zero, held over the rows of a 100 Hz one."""
    rng = np.random.default_rng(0)
    main = np.arange(2000) / 100.0
    sent = np.arange(200) / 10.0 + rng.uniform(0.0, 0.01, 200)
    last = np.searchsorted(sent, main, side="right") - 1
    rows = [f"{t},{sent[k] + 321.0},{np.sin(sent[k])}" for t, k in zip(main, last, strict=True) if k >= 0]
    data = {
        "time": {"column": "t"},
        "channels": {"speed": {"columns": "v", "time": "t2", "time_offset": "rows"}},
    }
    speed = read(tmp_path, data, "t,t2,v\n" + "\n".join(rows) + "\n").channel("speed")
    assert len(speed.time) == 200
    assert speed.time == pytest.approx(sent, abs=0.001)
    assert speed.values[:, 0] == pytest.approx(np.sin(sent))


def test_one_number_a_line_is_put_together_to_samples(tmp_path: Path, small_files: Any) -> None:
    folder = small_files.write_one_number_a_line(tmp_path / "run")
    data: dict[str, Any] = {
        "time": {"file": "run_time.txt"},
        "channels": {"position": {"file": "*positions*", "columns": "*", "width": 2, "labels": ["hip", "knee"]}},
    }
    (recording,) = formats.read(folder, ChannelMap.from_dict(data))
    expected = small_files.recording().channel("position")
    assert recording.channel("position").values == pytest.approx(expected.values, abs=1e-6)
    data["channels"]["position"] |= {"width": 3, "labels": []}
    with pytest.raises(FormatError, match=r"80 numbers are no multiple of 3 .* 2 are left over"):
        formats.read(folder, ChannelMap.from_dict(data))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({}, "no channel is named"),
        ({"chanels": {}}, "unknown key 'chanels'.*keys are: channels, joints, time"),
        (mapped(columns="a", united="rad"), r"\[channels.position\]: unknown key 'united'.*keys are: .*unit"),
        (mapped(unit="rad"), "'columns' is missing"),
        (mapped(columns=[]), "'columns' is empty"),
        (mapped(columns=3), "columns: 3 is not a list of texts"),
        (mapped(columns="a", unit="ticks"), "unit 'ticks' .*give a scale"),
        (mapped(columns="a", scale="2"), "scale: '2' is not a finite number"),
        (mapped(columns="a", scale=[]), "scale: the list is empty"),
        (mapped(columns="a", scale=True), "scale: True is not a finite number"),
        (mapped(columns="a", sign=2), r"sign is \[2.0\]; each must be 1 or -1"),
        (mapped(columns="a", rate=0), "0 Hz is not a positive rate"),
        (mapped(columns="a", width=-1), "width: -1 is not a number of columns"),
        (mapped(columns="a", time_offset="soon"), "time_offset: 'soon'"),
        ({"time": {"unit": "rad"}, "channels": {"a": {"columns": "a"}}}, "'rad' is not a unit of time"),
        ({"time": {"repair": "guess"}, "channels": {"a": {"columns": "a"}}}, "'guess' is unknown; choices are: 'sort'"),
        ({"time": {"column": "t", "rate": 5}, "channels": {"a": {"columns": "a"}}}, "both column and rate"),
        ({"time": 5, "channels": {"a": {"columns": "a"}}}, "5 is not a table of keys"),
        ({"channels": {"a": {"columns": "a"}}, "joints": {"a": 1}}, r"\[joints\], a = 1: must be text"),
    ],
)
def test_what_a_mapping_cannot_mean_is_refused_by_name(data: dict[str, Any], message: str) -> None:
    with pytest.raises(MappingError, match=message):
        ChannelMap.from_dict(data)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (mapped(columns="angle"), "no column 'angle'; columns are: t_ms, cmd_hip"),
        (mapped(columns=["pos_hip", "vel_*"]), r"no column 'vel_\*'"),
        (mapped(columns="pos_*", labels=["hip"]), r"1 labels \(hip\) for 2 columns"),
        (mapped(columns="pos_*", scale=[1, 2, 3]), "3 numbers for scale; give one, or 2"),
        (mapped(columns="pos_*", file="other.csv"), "no file or topic 'other.csv'; there are: log.csv"),
        (mapped(columns="pos_*", time="t2"), "no column 't2' for the time; columns are: t_ms"),
        ({"channels": {"position": {"columns": "pos_*"}}}, "no time for .* or give rate"),
        ({"time": {"column": "stamp"}, "channels": {"position": {"columns": "pos_*"}}}, "no column 'stamp'"),
        ({"time": {"file": "t.csv"}, "channels": {"position": {"columns": "pos_*"}}}, "0 files are 't.csv'; files"),
    ],
)  # fmt: skip
def test_what_a_mapping_names_must_be_in_the_file(tmp_path: Path, data: dict[str, Any], message: str) -> None:
    with pytest.raises(MappingError, match=message):
        read(tmp_path, data)


def test_a_mapping_that_is_no_toml_is_named_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "mapping.toml"
    path.write_text("[time]\ncolumn = \n")
    with pytest.raises(MappingError, match=r"mapping.toml: not valid TOML .*line 2"):
        ChannelMap.load(path)
    with pytest.raises(MappingError, match="no such file"):
        ChannelMap.load(tmp_path / "nothing.toml")


def test_a_mapping_that_cannot_be_written_says_so(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="is a folder"):
        ChannelMap({"position": ChannelColumns(("q",))}).save(tmp_path)


texts = st.text(st.characters(exclude_categories=("Cs",)), max_size=8)
numbers = st.lists(st.floats(-1e9, 1e9), min_size=1, max_size=3).map(tuple)
channels = st.builds(
    ChannelColumns,
    columns=st.lists(texts, min_size=1, max_size=3).map(tuple),
    file=texts,
    labels=st.lists(texts, max_size=3).map(tuple),
    unit=st.sampled_from(["", "rad", "deg", "N m", "mA"]),
    scale=numbers,
    offset=numbers,
    sign=st.sampled_from([(1.0,), (-1.0,), (1.0, -1.0)]),
    width=st.integers(0, 9),
    time=texts,
    time_unit=st.sampled_from(["", "s", "us"]),
    time_offset=st.one_of(st.just("rows"), st.floats(-1e9, 1e9)),
    rate=st.one_of(st.none(), st.floats(1e-3, 1e6)),
)
times = st.one_of(
    st.builds(TimeColumn, column=texts, nanoseconds=texts, unit=st.sampled_from(["", "ms"]), file=texts),
    st.builds(TimeColumn, rate=st.floats(1e-3, 1e6), repair=st.sampled_from(["", "sort", "drop", "continue"])),
)


@given(
    st.dictionaries(texts, channels, min_size=1, max_size=3), times, st.dictionaries(texts, texts, max_size=3),
    st.lists(st.text(max_size=20), max_size=2),
)  # fmt: skip
@example({"position": ChannelColumns(("q*",), offset=(0.0, 0.0))}, TimeColumn(), {}, [])  # usual, but one for each
def test_a_mapping_saved_is_the_mapping_loaded(
    tmp_path_factory: pytest.TempPathFactory,
    entries: dict[str, ChannelColumns],
    time: TimeColumn,
    joints: dict[str, str],
    notes: list[str],
) -> None:
    path = tmp_path_factory.mktemp("toml") / "mapping.toml"
    made = ChannelMap(entries, time, joints, tuple(notes))
    made.save(path)
    back = ChannelMap.load(path)
    assert (dict(back.channels), back.time, dict(back.joints)) == (entries, time, joints)
