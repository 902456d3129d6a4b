# SPDX-License-Identifier: Apache-2.0
"""Text tables are read whatever their layout, and a fault in one is named with its line, column and value."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trueup import formats
from trueup.errors import FormatError, MappingError
from trueup.recording import Recording


def read(path: Path, text: str | bytes, **time_keys: Any) -> Recording:
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    mapping = None
    if time_keys:
        channels = {"position": {"columns": "q*", "unit": "rad"}}
        mapping = formats.ChannelMap.from_dict({"time": {"column": "time", **time_keys}, "channels": channels})
    (recording,) = formats.read(path, mapping)
    return recording


def rows(*lines: str) -> str:
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    "text",
    [
        rows("time,q1,q2", "0,1,-2", "0.01,1.5,2", "0.02,2,3"),
        rows("time;q1;q2", "0;1;-2", "0.01;1.5;2", "0.02;2;3"),
        rows("time;q1;q2", "0,00;1,0;-2,0", "0,01;1,5;2,0", "0,02;2,0;3,0"),
        rows("time\tq1\tq2", "0\t1\t-2", "0.01\t1.5\t2", "0.02\t2\t3"),
        rows("time q1 q2", "  0.00  1   -2", "0.01 1.5 2", "0.02     2 3 "),
        rows("# time q1 q2", "0 1 -2", "0.01 1.5 2", "0.02 2 3"),
        rows("time, q1, q2", "0, 1, -2", "0.01, 1.5, 2", "0.02, 2, 3"),
        rows('"time","q1","q2"', '"0","1","-2"', '"0.01","1.5","2"', '"0.02","2","3"'),
        rows("Robot: two joints", "Date: 2024-01-01", "", "time,q1,q2", "0,1,-2", "0.01,1.5,2", "0.02,2,3"),
        rows("time,q1,q2", "s,rad,rad", "0,1,-2", "0.01,1.5,2", "0.02,2,3"),
        rows("time [ms],q1 [rad],q2 [rad]", "0,1,-2", "10,1.5,2", "20,2,3"),
        rows("time_us,q1,q2", "0,1,-2", "10000,1.5,2", "20000,2,3"),
        rows("time,q1,q2", "0,1,-2", "# the operator coughed", "0.01,1.5,2", "", "0.02,2,3"),
        rows("time,q1,q2,", "0,1,-2,", "0.01,1.5,2,", "0.02,2,3,"),
        rows(",time,q1,q2", "0,0,1,-2", "1,0.01,1.5,2", "2,0.02,2,3"),
        rows('time,q', '0,"[1, -2]"', '0.01,"[1.5, 2]"', '0.02,"[2, 3]"'),
        rows('time,q', '0,"[ 1.  -2. ]"', '0.01,"[ 1.5  2. ]"', '0.02,"[2. 3.]"'),
        rows("time;q", "0;(1, -2)", "0.01;(1.5, 2)", "0.02;(2, 3)"),
        rows("time,q", "0,[1, -2]", "0.01,[1.5, 2]", "0.02,[2, 3]"),
        rows("mode,time,q1,q2", "IDLE,0,1,-2", "RUN,0.01,1.5,2", "RUN,0.02,2,3"),
        "time,q1,q2\r\n0,1,-2\r\n0.01,1.5,2\r\n0.02,2,3",
        b"\xef\xbb\xbf" + rows("time,q1,q2", "0,1,-2", "0.01,1.5,2", "0.02,2,3").encode(),
        rows("time,q1,q2", "0,1,-2", "0.01,1.5,2", "0.02,2,3").encode("utf-16"),
    ],
)  # fmt: skip
def test_one_content_in_any_layout_is_one_recording(tmp_path: Path, text: str | bytes) -> None:
    position = read(tmp_path / "log.csv", text).channel("position")
    assert position.unit == "rad"
    assert position.labels == ("joint_1", "joint_2")
    assert position.time == pytest.approx([0.0, 0.01, 0.02])
    assert np.allclose(position.values, [[1.0, -2.0], [1.5, 2.0], [2.0, 3.0]])


@pytest.mark.parametrize(
    ("stamps", "steps"),
    [
        (["1700000000.00", "1700000000.01", "1700000000.02"], 0.01),
        (["1700000000000", "1700000000010", "1700000000020"], 0.01),
        (["1700000000000000000", "1700000000010000000", "1700000000020000000"], 0.01),
        (["2024-05-01 10:00:00.00", "2024-05-01 10:00:00.01", "2024-05-01 10:00:00.02"], 0.01),
        (["2024-05-01T10:00:00.000Z", "2024-05-01T10:00:00.010Z", "2024-05-01T10:00:00.020Z"], 0.01),
        (["23:59:59.990", "00:00:00.000", "00:00:00.010"], 0.01),
        (["0", "1", "2"], 0.001),
    ],
)
def test_clocks_of_any_kind_tick_in_seconds(tmp_path: Path, stamps: list[str], steps: float) -> None:
    recording = read(tmp_path / "log.csv", rows("stamp,q1", *(f"{stamp},{i}" for i, stamp in enumerate(stamps))))
    assert np.diff(recording.time) == pytest.approx(steps, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "steps", "expected"), [("tick", 2, 0.002), ("tick_us", 2000, 0.002), ("Ticks", 20, 0.02)]
)
def test_what_ticks_evenly_is_the_clock_where_none_is_named(
    tmp_path: Path, name: str, steps: int, expected: float
) -> None:
    lines = [f"{1000 + steps * i},{np.sin(0.1 * i):.4f}" for i in range(20)]
    recording = read(tmp_path / "log.csv", rows(f"{name},q1", *lines))
    assert np.diff(recording.time) == pytest.approx(expected)


def test_ticks_of_an_encoder_beside_a_clock_are_none(tmp_path: Path) -> None:
    recording = read(tmp_path / "log.csv", rows("t,ticks,q1", *(f"{0.01 * i},{3 * i},0.{i}" for i in range(9))))
    assert np.diff(recording.time) == pytest.approx(0.01)


def test_seconds_and_nanoseconds_in_two_columns_are_one_clock(tmp_path: Path) -> None:
    stamps = ["1700000000,990000000", "1700000001,0", "1700000001,10000000", "1700000001,20000000"]
    recording = read(tmp_path / "log.csv", rows("sec,nanosec,q1", *(f"{stamp},1" for stamp in stamps)))
    assert recording.time == pytest.approx([0.0, 0.01, 0.02, 0.03], abs=1e-6)
    assert recording.provenance["time_origin"].startswith("1700000000.99")


def test_topics_of_different_rates_in_one_table_keep_their_own_samples(tmp_path: Path) -> None:
    lines = [f"{i / 100},{i},," if i % 2 else f"{i / 100},,{i},{-i}" for i in range(40)]
    names = "__time,/controller/commands/hip,/joint_states/hip/position,/joint_states/knee/position"
    recording = read(tmp_path / "log.csv", rows(names, *lines))
    position = recording.channel("position")
    assert position.labels == ("hip", "knee")
    assert position.time == pytest.approx(np.arange(20) / 50.0)
    assert not np.isnan(position.values).any()
    assert recording.channel("command").labels == ("hip",)


def test_a_missing_cell_is_a_missing_sample(tmp_path: Path) -> None:
    recording = read(tmp_path / "log.csv", rows("time,q1,q2", "0,1,2", "0.1,,nan", "0.2,inf,3"))
    assert np.isnan(recording.channel("position").values).tolist() == [[False, False], [True, True], [True, False]]
    assert "position: 3 of 6 values are missing" in recording.provenance["warnings"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"log.csv is empty"),
        ("time,q1\n", r"log.csv: no rows; its only line names columns: time, q1"),
        (bytes(range(256)) * 8, r"is not a text file"),
        (rows("time,q1", "0,1", "0.1,\x00", "0.2,1"), r"line 3: a zero byte"),
        (rows("time,q1", "0,1", "0.1,1", "time,q1", "0,1", "0.1,2"), r"'time' is not a number; the header stands there"),
        (rows("time,q1", "0,1", "0.1,up", "0.2,1", "0.3,2"), r"line 3, column 'q1': 'up' is not a number"),
        (rows("#", "time,q1", "#", "0,1", "", "0.1,up", "0.2,1", "0.3,2"), r"line 6, column 'q1': 'up'"),
        (rows("time,q1,q2", "0,1,2", "0.1,1", "0.2,1,2", "0.3,1,2"), r"line 3: 2 cells, but there are 3 columns"),
        (rows("time,q1", "0,1", "0.1,1,5,6", "0.2,1", "0.3,2"), r"line 3: 4 cells, but there are 2 columns"),
        (rows("time,q1,q2", "0,1", "0.1,2", "0.2,3"), r"line above the data has 3 names, the lines of data 2 cells"),
        (rows("time,q", '0,"[1, 2]"', '0.1,"[1]"', '0.2,"[3, 4]"'), r"line 3, column 'q': the list has 1 numbers"),
        (rows("time,q", '0,"[1, 2]"', '0.1,"[1, x]"', '0.2,"[3, 4]"'), r"line 3, column 'q': '\[1, x\]' is not a list"),
        (rows("time,q1", "0,1", '0.1,"2', "0.2,3", "0.3,4"), r"line 3: a quote is not closed"),
        (rows("time,q1", "0,1", ",2", "0.2,3"), r"line 3: the time is missing \(1 such rows\).*repair"),
        (rows("time,q1", "0,1", "0.2,2", "0.1,3", "0.3,4"), r'line 4: time goes back from 0.2 to 0.1 s.*"sort"'),
        (rows("stamp,q1", "0.3,1", "0.2,2", "0.1,3", "0,4"), r"time runs backwards, from 0.3 to 0 s in column 'stamp'.*sort"),
        (rows("time,q1", "0,1", "0.1,2", "0.1,3", "0.2,4"), r'line 4: time 0.1 s again, with other values.*"drop"'),
    ],
)  # fmt: skip
def test_a_fault_is_named_with_its_place_and_value(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(FormatError, match=message):
        read(tmp_path / "log.csv", text)


def test_rows_that_stand_newest_first_are_read_in_the_order_of_time(tmp_path: Path) -> None:
    lines = ["time,q1,time_left", "0.3,4,1", "0.2,3,2", "0.1,2,3", "0,1,4"]
    (tmp_path / "log.csv").write_text("\n".join([lines[0], *lines[:0:-1]]) + "\n")
    assert formats.guess_mapping(tmp_path / "log.csv").time.column == "time", "what counts down beside a clock is none"
    (tmp_path / "log.csv").write_text("\n".join(line.rpartition(",")[0] for line in lines) + "\n")
    mapping = formats.guess_mapping(tmp_path / "log.csv")
    sorted_by = dataclasses.replace(mapping, time=dataclasses.replace(mapping.time, repair="sort"))
    (recording,) = formats.read(tmp_path / "log.csv", sorted_by)
    assert recording.channel("position").values[:, 0].tolist() == [1.0, 2.0, 3.0, 4.0]


def test_a_file_that_is_not_there_says_so(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"nothing.csv: no such file"):
        formats.read(tmp_path / "nothing.csv")


@pytest.mark.parametrize("end", ["0.3,4", "0.3", '0.3,"[4, 5', "0.3,4,-", "0.3,4,1e"])
def test_a_last_line_that_was_cut_off_costs_that_line_only(tmp_path: Path, end: str) -> None:
    recording = read(tmp_path / "log.csv", "time,q1,q2\n0,1,2\n0.1,2,3\n0.2,3,4\n" + end)
    assert recording.channel("position").values.tolist() == [[1.0, 2.0], [2.0, 3.0], [3.0, 4.0]]
    assert "the last line (5) is cut off" in recording.provenance["warnings"]


def test_a_missing_newline_at_the_end_costs_nothing(tmp_path: Path) -> None:
    assert len(read(tmp_path / "log.csv", "time,q1\n0,1\n0.1,2\n0.2,3").time) == 3


def test_a_clock_that_was_set_back_goes_on_where_the_mapping_says_so(tmp_path: Path) -> None:
    text = rows("time,q1", "0,1", "0.1,2", "0.2,3", "0.1,4", "0.2,5", "0.3,6")
    recording = read(tmp_path / "log.csv", text, repair="continue")
    assert recording.channel("position").time == pytest.approx(np.arange(6) * 0.1)
    assert recording.channel("position").values[:, 0].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert "goes back (1 times) it goes on by 0.1 s" in recording.provenance["warnings"]


def test_sorting_puts_rows_back_in_their_place(tmp_path: Path) -> None:
    text = rows("time,q1", "0,0", "0.2,2", "0.1,1", "0.1,9", "0.3,3")
    recording = read(tmp_path / "log.csv", text, repair="sort")
    assert recording.channel("position").values[:, 0].tolist() == [0.0, 1.0, 2.0, 3.0]
    assert "1 rows that repeat a time" in recording.provenance["warnings"]


def test_dropping_leaves_out_rows_that_do_not_advance(tmp_path: Path) -> None:
    text = rows("time,q1", "0,0", "0.2,2", "0.1,1", "0.2,9", ",5", "0.3,3")
    recording = read(tmp_path / "log.csv", text, repair="drop")
    assert recording.channel("position").values[:, 0].tolist() == [0.0, 2.0, 3.0]
    assert "rows without a time" in recording.provenance["warnings"]


def test_a_line_written_twice_is_dropped_with_a_word(tmp_path: Path) -> None:
    recording = read(tmp_path / "log.csv", rows("time,q1", "0,0", "0.1,1", "0.1,1", "0.2,2"))
    assert recording.time == pytest.approx([0.0, 0.1, 0.2])
    assert "1 of 4 rows that repeat" in recording.provenance["warnings"]


@pytest.mark.parametrize("order", ["each row twice", "two by two", "the file twice"])
def test_rows_that_stand_in_the_file_already_are_dropped_with_a_word(tmp_path: Path, order: str) -> None:
    lines = [f"{i / 100},{i}" for i in range(40)]
    written = {
        "each row twice": [line for line in lines for _ in range(2)],
        "two by two": [line for i in range(0, 40, 2) for line in lines[i : i + 2] * 2],
        "the file twice": lines * 2,
    }
    recording = read(tmp_path / "log.csv", rows("time,q1", *written[order]))
    assert recording.channel("position").values[:, 0].tolist() == list(range(40))
    assert "40 of 80 rows that repeat the time and values" in recording.provenance["warnings"]


def test_rows_of_one_time_with_other_values_are_not_passed_over(tmp_path: Path) -> None:
    lines = [f"{i // 2 / 100},{i}" for i in range(40)]
    with pytest.raises(FormatError, match=r"line 3: time 0 s again, with other values \(20 such rows of 40\)"):
        read(tmp_path / "log.csv", rows("time,q1", *lines))


def test_topics_in_one_table_keep_their_rates_and_all_samples_of_an_instant(tmp_path: Path) -> None:
    """As PlotJuggler exports a bag: a row for each message, two of which may have come at once."""
    fast = [(k / 100.0, f"{k / 100.0},,{np.sin(k / 100.0)}") for k in range(300)]
    slow = [(k / 20.0, f"{k / 20.0},{k},") for k in range(60)]
    path = tmp_path / "log.csv"
    path.write_text(rows("__time,/cmd/q1_cmd,/joint/q1", *(line for _, line in sorted(fast + slow))))
    (found,) = formats.read(path)
    assert found.channel("command").time == pytest.approx(np.arange(60) / 20.0)
    assert found.channel("command").values[:, 0].tolist() == list(range(60))
    assert found.channel("position").time == pytest.approx(np.arange(300) / 100.0)
    assert found.channel("position").values[:, 0] == pytest.approx(np.sin(np.arange(300) / 100.0))
    assert not [word for word in found.provenance.get("warnings", "").split(";") if "value" in word]


def test_a_column_that_holds_words_cannot_be_a_channel(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(rows("time,mode,q1", "0,IDLE,1", "0.1,RUN,2"))
    mapping = formats.ChannelMap.from_dict({"time": {"column": "time"}, "channels": {"mode": {"columns": "mode"}}})
    with pytest.raises(MappingError, match=r"column 'mode' .* holds words such as 'IDLE'"):
        formats.read(path, mapping)


def test_nothing_in_a_cell_is_ever_run(tmp_path: Path) -> None:
    marker = tmp_path / "ran"
    cell = f"\"[__import__('pathlib').Path('{marker}').touch()]\""
    with pytest.raises(FormatError):
        read(tmp_path / "log.csv", rows("time,q", f"0,{cell}", f"0.1,{cell}", '0.2,"[1]"', '0.3,"[1]"', '0.4,"[1]"'))
    assert not marker.exists()


def test_numbers_keep_all_their_digits(tmp_path: Path) -> None:
    values = np.random.default_rng(0).normal(size=200) * 10.0 ** np.arange(-100, 100)
    text = rows("time,q1", *(f"{i / 100!r},{float(value)!r}" for i, value in enumerate(values)))
    assert np.array_equal(read(tmp_path / "log.csv", text).channel("position").values[:, 0], values)


def test_a_file_of_millions_of_numbers_is_read_in_a_moment(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    line = ",".join(f"{0.123456789 * k:.12f}" for k in range(12))
    names = "time," + ",".join(f"q{k}" for k in range(12))
    path.write_text(rows(names, *(f"{i / 1000:.3f},{line}" for i in range(80_000))))
    start = time.perf_counter()
    (recording,) = formats.read(path)
    assert recording.channel("position").values.shape == (80_000, 12)
    assert time.perf_counter() - start < 3.0  # 15 MB; a loop in Python takes longer than that


@pytest.mark.parametrize("numbers", ["position", "position_0,position_1", "position[1],position[2]"])
def test_a_column_that_lists_the_names_of_joints_names_them(numbers: str, tmp_path: Path) -> None:
    lines = [f"time,name,{numbers}"]
    for k in range(4):
        values = f'"[{k / 10}, {k}]"' if "," not in numbers else f"{k / 10},{k}"
        lines.append(f"{k},\"['hip', 'left knee']\",{values}")
    (tmp_path / "states.csv").write_text("\n".join(lines) + "\n")
    (log,) = formats.read(tmp_path / "states.csv")
    assert log.channel("position").labels == ("hip", "left knee")
    assert log.channel("position").column("left knee").tolist() == [0.0, 1.0, 2.0, 3.0]


def test_nanoseconds_are_the_rest_of_whole_seconds_alone(tmp_path: Path) -> None:
    stamps = [(1700000000, 900000000), (1700000001, 0), (1700000001, 100000000), (1700000001, 200000000)]
    rows = [f"{s + n * 1e-9 + 0.003:.6f},{s},{n},{k},{k}" for k, (s, n) in enumerate(stamps)]
    header = "Time,header.stamp.secs,header.stamp.nsecs,header.seq,position"
    for first, name in ((0, "Time"), (1, "header.stamp.secs")):
        lines = [",".join(line.split(",")[first:]) for line in (header, *rows)]
        (tmp_path / "bag.csv").write_text("\n".join(lines) + "\n")
        (log,) = formats.read(tmp_path / "bag.csv")
        assert list(log.channels) == ["position"]
        assert formats.guess_mapping(tmp_path / "bag.csv").time.column == name
        assert log.time - log.start == pytest.approx([0.0, 0.1, 0.2, 0.3], abs=1e-6)


@pytest.mark.parametrize("frame", ["", "base_link"])
@pytest.mark.parametrize("parts", [1, 3])
def test_joint_states_as_ros_echoes_them_need_no_names_of_columns(frame: str, parts: int, tmp_path: Path) -> None:
    rows = [
        [
            1700000000 + k // 4,
            250000000 * (k % 4),
            frame,
            "hip",
            "knee",
            *(f"{0.1 * (k + c):.3f}" for c in range(2 * parts)),
        ]
        for k in range(8)
    ]
    (tmp_path / "states.csv").write_text("\n".join(",".join(map(str, row)) for row in rows) + "\n")
    (log,) = formats.read(tmp_path / "states.csv")
    assert list(log.channels) == ["position", "velocity", "torque"][:parts]
    assert log.channel("position").labels == ("hip", "knee")
    assert log.channel("position").column("knee") == pytest.approx(0.1 * (1.0 + np.arange(8)))
    assert log.time - log.start == pytest.approx(0.25 * np.arange(8))


def test_lists_as_python_prints_arrays_are_lists(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t,position\n" + "".join(f"{k},\"array('d', [{k}, 2.0])\"\n" for k in range(4)))
    (log,) = formats.read(tmp_path / "log.csv")
    assert log.channel("position").values.tolist() == [[k, 2.0] for k in range(4)]


@pytest.mark.parametrize(
    ("name", "full"),
    [("micros", 2**32), ("t_ms", 2**16), ("tick_ms", 2**16), ("realtime_tick_ms", 2**15), ("t_us", 2**24)],
)
def test_a_clock_whose_counter_was_full_goes_on(name: str, full: int, tmp_path: Path) -> None:
    each = 10 if name.endswith("ms") else 10000
    rows = [f"{(full - 4 * each - 7 + k * each) % full},{k}" for k in range(9)]
    (tmp_path / "log.csv").write_text(f"{name},position\n" + "\n".join(rows) + "\n")
    (log,) = formats.read(tmp_path / "log.csv")
    assert log.time - log.start == pytest.approx(0.01 * np.arange(9), abs=1e-9)
    assert "began anew" in log.provenance["warnings"]


def test_odometry_and_commands_as_ros_echoes_them_need_no_names_of_columns(tmp_path: Path) -> None:
    """nav_msgs/Odometry beside geometry_msgs/TwistStamped, of `ros2 topic echo --csv`, in a folder."""
    zeros, folder = ",".join(["0.0"] * 36), tmp_path / "drive"
    folder.mkdir()
    times = [(1700000000 + k // 20, 50000000 * (k % 20), 0.05 * k) for k in range(60)]
    odom = [
        f"{s},{ns},odom,base_link,{t:.4f},{t * t:.4f},0.0,0.0,0.0,{np.sin(t):.6f},{np.cos(t):.6f},{zeros},"
        f"{1.0 + t:.4f},0.0,0.0,0.0,0.0,{0.5 * t:.4f},{zeros}" for s, ns, t in times
    ]  # fmt: skip
    told = [f"{s},{ns},base_link,{1.1 + t:.4f},0.0,0.0,0.0,0.0,{0.6 * t:.4f}" for s, ns, t in times]
    (folder / "odom.csv").write_text("\n".join(odom) + "\n")
    (folder / "cmd_vel.csv").write_text("\n".join(told) + "\n")
    (found,) = formats.read(folder)
    t = np.array([time for *_, time in times])
    assert found.channel("position").values == pytest.approx(np.column_stack([t, t * t]), abs=1e-3)
    assert found.channel("speed").values[:, 0] == pytest.approx(1.0 + t, abs=1e-3)
    assert found.channel("command").column("speed") == pytest.approx(1.1 + t, abs=1e-3)
    assert found.channel("command").column("turn") == pytest.approx(0.6 * t, abs=1e-3)
