# SPDX-License-Identifier: Apache-2.0
"""Dates and times of day are a clock however people write them; what they do not tell is said."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from trueup import formats
from trueup.errors import MappingError
from trueup.formats.dates import parse_clock

NOON = 1711886400.0  # s, 2024-03-31 12:00 UTC


@pytest.mark.parametrize(
    "stamps",
    [
        ["31.03.2024 23:59:59.990", "01.04.2024 00:00:00.000", "01.04.2024 00:00:00.010"],
        ["31/3/2024 23:59:59.990", "1/4/2024 00:00:00.000", "1/4/2024 00:00:00.010"],
        ["03/31/2024 11:59:59.990 PM", "04/01/2024 12:00:00.000 AM", "04/01/2024 12:00:00.010 AM"],
        ["03/04/2024 23:59:59.990", "03/05/2024 00:00:00.000", "03/05/2024 00:00:00.010"],
        ["2024/12/31 23:59:59.990", "2025/01/01 00:00:00.000", "2025/01/01 00:00:00.010"],
        ["31.03.2024, 23:59:59,990", "01.04.2024, 00:00:00,000", "01.04.2024, 00:00:00,010"],
    ],
)
def test_a_log_over_midnight_ticks_on_whoever_wrote_its_dates(tmp_path: Path, stamps: list[str]) -> None:
    (tmp_path / "log.csv").write_text("stamp;q1\n" + "".join(f"{stamp};{i}\n" for i, stamp in enumerate(stamps)))
    (recording,) = formats.read(tmp_path / "log.csv")
    assert np.diff(recording.time) == pytest.approx(0.01, abs=1e-6)


def test_the_same_instant_is_the_same_number_in_every_order() -> None:
    for stamp in ("31.03.2024 12:00:00", "31-3-2024 12:00:00", "03/31/2024 12:00:00 PM", "2024-03-31T12:00:00,0Z"):
        read = parse_clock([stamp])
        assert read is not None
        assert (read.time[0], read.note) == (NOON, "")
    assert parse_clock(["31.02.2024 12:00:00"]) is None
    assert parse_clock(["13/13/2024 12:00:00"]) is None


def test_what_does_not_tell_day_from_month_is_noted_in_every_format(tmp_path: Path) -> None:
    stamps = [f"03/04/2024 12:00:00.{k:02d}" for k in range(0, 50, 5)]
    places = [0.1 * k for k in range(len(stamps))]
    (tmp_path / "log.csv").write_text("stamp,q1\n" + "".join(f"{s},{q}\n" for s, q in zip(stamps, places, strict=True)))
    (tmp_path / "log.json").write_text(json.dumps({"stamp": stamps, "q1": places}))
    pq.write_table(pa.table({"stamp": stamps, "q1": places}), tmp_path / "log.parquet")
    for name in ("log.csv", "log.json", "log.parquet"):
        (recording,) = formats.read(tmp_path / name)
        assert np.diff(recording.time) == pytest.approx(0.05, abs=1e-6)
        assert "dates such as 03/04/2024 were read as day and month" in recording.provenance["warnings"]


def test_words_that_are_no_time_are_shown_where_a_mapping_names_them(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("stamp,q1\n" + "".join(f"31.02.2024 12:00:0{i},{i}\n" for i in range(5)))
    (tmp_path / "mapping.toml").write_text('[time]\ncolumn = "stamp"\n[channels.position]\ncolumns = ["q1"]\n')
    with pytest.raises(
        MappingError, match=r"'stamp' cannot be the time, as it holds words such as '31\.02\.2024 12:00:00'"
    ):
        formats.read(tmp_path / "log.csv", tmp_path / "mapping.toml")
