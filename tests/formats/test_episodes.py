# SPDX-License-Identifier: Apache-2.0
"""Files that hold many runs are as many recordings, and a data set's own description names their joints."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from trueup.formats import guess_mapping, read

JOINTS = ["pan", "lift", "grip"]


def _data_set(root: Path) -> Path:
    """Two runs of 30 and 20 frames at 30 Hz in one file, as LeRobot lays them out."""
    lengths, rng = (30, 20), np.random.default_rng(0)
    state = rng.normal(0.0, 0.5, (50, 3))
    number = np.repeat([0, 1], lengths)
    frame = np.concatenate([np.arange(n) for n in lengths])
    columns = {
        "observation.state": pa.array(state.tolist(), pa.list_(pa.float64(), 3)),
        "action": pa.array((state + 0.01).tolist(), pa.list_(pa.float64(), 3)),
        "timestamp": frame / 30.0, "frame_index": frame, "episode_index": number, "index": np.arange(50),
    }  # fmt: skip
    feature = {"dtype": "float32", "shape": [3], "names": [f"{j}.pos" for j in JOINTS]}
    for folder in ("data/chunk-000", "meta/episodes/chunk-000"):
        (root / folder).mkdir(parents=True)
    pq.write_table(pa.table(columns), root / "data/chunk-000/file-000.parquet")
    pq.write_table(pa.table({"length": lengths}), root / "meta/episodes/chunk-000/file-000.parquet")
    (root / "meta/info.json").write_text(json.dumps({"features": {"observation.state": feature, "action": feature}}))
    return root


def test_a_data_set_of_episodes_is_one_recording_each_with_the_names_it_gives(tmp_path: Path) -> None:
    first, second = read(_data_set(tmp_path))
    assert (first.name, second.name) == ("episode_0", "episode_1")
    assert (len(first.time), len(second.time)) == (30, 20)
    assert second.time[0] == 0.0
    assert set(first.channels) == {"command", "position"}
    assert first.channel("position").labels == first.channel("command").labels == tuple(JOINTS)
    np.testing.assert_allclose(second.channel("command").values, second.channel("position").values + 0.01)


def test_a_mapping_guessed_from_one_episode_reads_them_all(tmp_path: Path) -> None:
    root = _data_set(tmp_path)
    mapping = guess_mapping(root)
    assert [len(r.time) for r in read(root / "data", mapping)] == [30, 20]


def test_a_csv_with_a_column_of_episodes_is_split(tmp_path: Path) -> None:
    rows = [(e, k * 0.1, 0.01 * k + e) for e in (3, 7) for k in range(8)]
    path = tmp_path / "log.csv"
    path.write_text("episode,t,pos_a\n" + "".join(f"{e},{t:g},{q:g}\n" for e, t, q in rows))
    first, second = read(path)
    assert (first.name, second.name) == ("log_3", "log_7")
    np.testing.assert_allclose(second.channel("position").values[:, 0], 7 + 0.01 * np.arange(8))


def test_a_file_for_each_episode_keeps_its_name(tmp_path: Path) -> None:
    root = _data_set(tmp_path)
    whole = pq.read_table(root / "data/chunk-000/file-000.parquet")
    (root / "data/chunk-000/file-000.parquet").unlink()
    for number in (0, 1):
        one = whole.filter(pc.field("episode_index") == number)
        pq.write_table(one, root / f"data/chunk-000/episode_00000{number}.parquet")
    first, second = read(root)
    assert (first.name, second.name) == ("episode_000000", "episode_000001")
    assert first.channel("position").labels == tuple(JOINTS)


def test_drives_in_one_file_are_told_apart_by_the_name_of_their_run(tmp_path: Path) -> None:
    path = tmp_path / "drives.csv"
    rows = "".join(f"{run},{k / 10},{k}\n" for run in ("north", "south") for k in range(8))
    path.write_text("run_id,time,pos_a\n" + rows)
    assert [r.name for r in read(path)] == ["drives_north", "drives_south"]
    path.write_text("running,time,pos_a\n" + "".join(f"{int(k > 3)},{k / 10},{k}\n" for k in range(8)))
    assert [r.name for r in read(path)] == ["drives"]
