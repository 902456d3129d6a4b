# SPDX-License-Identifier: Apache-2.0
"""Replays to files: what was measured and simulated, sample by sample, as CSV, NPZ or Parquet."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from trueup.calibration import Replay
from trueup.formats import parquet
from trueup.formats.aside import written_aside
from trueup.recording import Channel, Recording

KINDS = ("csv", "npz", "parquet")


def write_replays(replays: Sequence[Replay], folder: Path, kind: str, *, compared: bool) -> list[Path]:
    """One file a recording, columns time (s), measured/CHANNEL/LABEL, simulated/..., against/... where `compared`, in SI.

    Channels with instants of their own have a time of their own, and in CSV a file of their own. Raises OutputError.
    """
    written = []
    for name in dict.fromkeys(r.recording for r in replays):
        own = [r for r in replays if r.recording == name]
        parts = _channels(own, compared=compared)
        if kind == "csv":
            written += [_csv(own, k, parts, folder) for k in range(len(own))]
            continue
        path = folder / f"{_plain(name)}.{kind}"
        if kind == "parquet":
            parquet.write(Recording(name, {c.name: c for channels in parts for c in channels}, {}), path)
        else:
            _npz(parts, path)
        written.append(path)
    return written


def _channels(replays: Sequence[Replay], *, compared: bool) -> list[list[Channel]]:
    """What is written of each replay."""
    found = []
    for r in replays:
        values = {"measured": r.measured, "simulated": r.after, **({"against": r.before} if compared else {})}
        if r.command is not None:
            values["command"] = r.command
        found.append([Channel(f"{kind}/{r.channel}", r.labels, r.unit, r.time, v) for kind, v in values.items()])
    return found


def _csv(replays: Sequence[Replay], which: int, parts: Sequence[Sequence[Channel]], folder: Path) -> Path:
    replay, channels = replays[which], parts[which]
    more = f"-{_plain(replay.channel)}" if which else ""
    path = folder / f"{_plain(replay.recording)}{more}.csv"
    with written_aside(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time [s]", *(f"{c.name}/{label} [{c.unit}]" for c in channels for label in c.labels)])
        for row in np.column_stack([replay.time, *(c.values for c in channels)]):
            writer.writerow([f"{value:.9g}" for value in row])
    return path


def _npz(parts: Sequence[Sequence[Channel]], path: Path) -> None:
    arrays: dict[str, np.ndarray] = {}
    for channels in parts:
        for c in channels:
            arrays |= {c.name: c.values, f"{c.name}/time": c.time, f"{c.name}/labels": np.array(c.labels)}
    with written_aside(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)  # pyright: ignore[reportArgumentType]


def _plain(name: str) -> str:
    return name.replace("/", "_") or "recording"
