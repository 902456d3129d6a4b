# SPDX-License-Identifier: Apache-2.0
"""What an operator is given for one trial: a sheet to read, and the numbers as CSV files."""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from trueup.arrays import Array
from trueup.ends import Fallen, Left
from trueup.errors import OutputError
from trueup.formats import ChannelColumns, ChannelMap, TimeColumn
from trueup.robots.by_hand.check import lacks_command
from trueup.robots.by_hand.eyes import explained, template
from trueup.rounding import PRINTED, ROUNDED
from trueup.trial import Trial


def write_sheet(trial: Trial, outbox: Path, inbox: Path) -> Path:
    """Makes outbox/TRIAL/ with README.txt, settings.csv, command.csv, one CSV for each reference, and trial.json.

    The folder appears whole or not at all; one that is there already is left as it is. Raises OutputError.
    """
    folder = outbox / trial.name
    if folder.exists():
        return folder
    aside = outbox / f".{trial.name}.part"
    try:
        shutil.rmtree(aside, ignore_errors=True)  # our own unfinished one
        aside.mkdir(parents=True)
        if trial.settings:
            units = {p.name: p.unit for p in trial.tuned}
            rows = [(k, repr(float(v)), units.get(k, "")) for k, v in trial.settings.items()]
            _csv(aside / "settings.csv", ("name", "value", "unit"), rows)
        if trial.command is not None:
            c = trial.command
            head = ("time_s", *(f"{label} [{c.unit}]" for label in c.labels))
            _csv(aside / "command.csv", head, _numbers(np.column_stack([c.time - trial.start, c.values])))
        for name, r in trial.references.items():
            _csv(aside / f"{name}.csv", r.columns, _numbers(r.values))
        _csv(aside / "log-header.csv", tuple(canonical(trial)), [])
        if trial.watched:
            (aside / f"{trial.name}.toml").write_text(template(trial), encoding="utf-8")
        (aside / "trial.json").write_text(json.dumps(_plain(trial), indent=1) + "\n", encoding="utf-8")
        (aside / "README.txt").write_text(words(trial, inbox), encoding="utf-8")
        os.replace(aside, folder)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written ({error.strerror or error})") from None
    return folder


def canonical(trial: Trial) -> dict[str, str]:
    """Names that a log's columns may have so that no mapping is needed -> unit."""
    names = {"time": "s"}
    for channel, o in trial.observed.items():
        names.update({f"{channel}/{label}": _unit(o.unit) for label in o.labels})
    return names


def canonical_map(trial: Trial) -> ChannelMap:
    """The mapping of a log that has these names."""
    channels = {
        name: ChannelColumns(columns=tuple(f"{name}/{label}" for label in o.labels), labels=o.labels, unit=o.unit)
        for name, o in trial.observed.items()
    }
    return ChannelMap(channels, TimeColumn(column="time", unit="s"))


def _reached(end: Fallen | Left) -> str:
    """What is seen where a run ends so."""
    if isinstance(end, Left):
        sides = [(f"{n} below", low) for n, (low, _) in end.area.items()] + [
            (f"{n} above", h) for n, (_, h) in end.area.items()
        ]
        return f"{end.channel} " + " or ".join(f"{side} {bound:.4g}" for side, bound in sides if math.isfinite(bound))
    low = [] if end.height is None else [f"{end.position} z below {end.height:.3g} m"]
    return " or ".join(low + ([] if end.tilt is None else [f"leaning by more than {end.tilt:.3g} rad"]))


def words(trial: Trial, inbox: Path) -> str:
    """The sheet."""
    seen = "what you saw, or its log," if trial.watched else "its log"
    lines = [f"{trial.name}: run this once, then put {seen} into {inbox}/", "=" * 72, ""]
    if trial.repeats > 1:
        logs = f"{trial.repeats} " + ("files of what you saw, or logs," if trial.watched else "logs")
        lines[0] = f"{trial.name}: run this {trial.repeats} times, then put the {logs} into {inbox}/"
    lines += [f"It is the run '{trial.performs}'.", ""] if trial.performs else []
    lines += _to_set(trial)
    over = [f"  {end.name}: {_reached(end)}" for end in trial.ends if isinstance(end, (Fallen, Left))]
    lines += [f"The run lasts {trial.duration:.4g} s. Start the log when it starts."]
    lines += ["It is over before where one of these is reached; let the log go on for a moment:", *over] if over else []
    lines += [*trial.notes, ""]
    lines += _limits(trial)
    lines += explained(trial, str(inbox))
    lines += ["Record, with the time of each sample in s:"]
    for channel, o in trial.observed.items():
        rate = (len(o.time) - 1) / (o.time[-1] - o.time[0]) if len(o.time) > 1 else math.nan
        lines.append(f"  {channel:14} {', '.join(o.labels)}   in {_unit(o.unit)}, at {rate:.3g} Hz or faster")
    if lacks_command(trial):
        what = "what the controller commanded each drive (a torque in N m, or a position), at each change"
        lines += [f"  and {what}:", "  without it no simulator is fitted to the run"]
    lines += [
        "", "Any format that trueup reads is fine: CSV, JSON, NPZ, Parquet, MAT, HDF5, MCAP. Columns named as in",
        f"log-header.csv need no mapping; for others put a mapping.toml into {inbox}/ (`trueup inspect LOG` writes one).", "",
        f"Name the log (or a folder with it) {trial.name}, for example {trial.name}.csv. If something went wrong, put a text",
        "file with a note in it there instead, or beside the log:", "",
        f"  {trial.name}-aborted.txt   you stopped it; it says nothing about the settings",
        f"  {trial.name}-fell.txt      {_fallen(trial)}",
        f"  {trial.name}-repeat.txt    you will run it again; what was put there before does not count", "",
    ]  # fmt: skip
    return "\n".join(lines)


def _fallen(trial: Trial) -> str:
    """What a note of a fall is for: where something else shows it, that says more."""
    if trial.watched:
        return "the robot fell, and nobody saw how; fell = ... as above says more, and so does a log"
    if any(isinstance(end, Fallen) for end in trial.ends):
        return "the robot fell, and its log does not show how; a log that does says more, by itself"
    return "the robot fell, crashed or left the track: the settings are bad"


def _to_set(trial: Trial) -> list[str]:
    lines: list[str] = []
    if trial.settings:
        width = max(map(len, trial.settings))
        lines += ["Set the controller to (settings.csv):"]
        known = {p.name: p for p in trial.tuned}
        for name, value in trial.settings.items():
            unit = known[name].unit if name in known else ""
            means = f"({known[name].source})" if name in known and known[name].source else ""
            shown = f"{value:.6g} {'' if unit == '1' else unit}"
            lines.append(f"  {name:{width}}  {shown:16} {means}".rstrip())
        lines.append("")
    if trial.command is not None:
        c = trial.command
        lines += [
            f"Send command.csv: {len(c.time)} rows of {', '.join(c.labels)} in {_unit(c.unit)}, each held to the next."
        ]
        for label, column in zip(c.labels, c.values.T, strict=True):
            lines.append(
                f"  {label:14} from {column.min():.4g} to {column.max():.4g} {c.unit}, begins at {column[0]:.4g}"
            )
        lines.append("")
    for name, r in trial.references.items():
        lines += [f"Follow {name}.csv: {len(r.values)} rows of {', '.join(r.columns)}."]
        lines += [
            f"  {label:14} {_range(low, high, unit)}"
            for label, unit, low, high in zip(
                r.labels, r.units, r.values.min(axis=0), r.values.max(axis=0), strict=True
            )
        ] + [""]
    for name, channel in trial.initial.items():
        values = np.where(np.abs(channel.values[0]) < PRINTED, 0.0, channel.values[0])  # what settling leaves of zero
        at = ", ".join(f"{label} {v:.4g}" for label, v in zip(channel.labels, values, strict=True))
        lines.append(f"Start with {name}: {at} {channel.unit}")
    return [*lines, ""] if trial.initial else lines


def _limits(trial: Trial) -> list[str]:
    limits = trial.limits
    if limits is None:
        return ["The plan sets no limits ([limits]): stop the run whenever you would.", ""]
    lines = ["Stop the run if it goes beyond:"]
    for k, label in enumerate(limits.labels):
        unit = _unit_of(trial, label)
        low, high, speed, effort = limits.lower[k], limits.upper[k], limits.speed[k], limits.effort[k]
        parts = [_range(low, high, unit)] if np.isfinite([low, high]).any() else []
        parts += [f"speed {speed:.4g}" + (f" {unit}/s" if unit else "")] if np.isfinite(speed) else []
        parts += [f"effort {effort:.4g} {'N' if unit == 'm' else 'N m'}"] if np.isfinite(effort) else []
        lines.append(f"  {label:14} {', '.join(parts)}")
    for label, (low, high) in limits.workspace.items():
        lines.append(f"  {label:14} {_range(low, high, _unit_of(trial, label))}")
    return [*lines, ""]


def _range(low: float, high: float, unit: str) -> str:
    if np.isfinite(low) and np.isfinite(high):
        low, high = (0.0 if abs(x) < ROUNDED * max(abs(low), abs(high)) else x + 0.0 for x in (low, high))
        return f"{low:.4g} to {high:.4g} {unit}".rstrip()
    return (f"at least {low:.4g} {unit}" if np.isfinite(low) else f"at most {high:.4g} {unit}").rstrip()


def _unit_of(trial: Trial, label: str) -> str:
    """The unit that a label has in what is commanded, measured or followed; '' where nobody says."""
    units = {x: unit for r in trial.references.values() for x, unit in zip(r.labels, r.units, strict=True)}
    units |= {x: o.unit for o in trial.observed.values() if o.unit in ("rad", "m") for x in o.labels}
    if trial.command is not None:
        units |= {x: trial.command.unit_of(x) for x in trial.command.labels}
    return units.get(label, "")


def _plain(trial: Trial) -> dict[str, object]:
    """The trial for a program that reads it."""
    return {
        "trial": trial.name, "performs": trial.performs, "duration": trial.duration, "repeats": trial.repeats,
        "settings": dict(trial.settings),
        "command": "command.csv" if trial.command is not None else None,
        "references": {name: f"{name}.csv" for name in trial.references},
        "record": {name: {"labels": list(o.labels), "unit": o.unit} for name, o in trial.observed.items()},
        "columns": canonical(trial),
    }  # fmt: skip


def _csv(path: Path, head: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    lines = [",".join(head), *(",".join(row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _numbers(values: Array) -> list[list[str]]:
    return [[f"{v:.9g}" for v in row] for row in values]


def _unit(unit: str) -> str:
    return unit or "SI units"
