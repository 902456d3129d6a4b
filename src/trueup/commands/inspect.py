# SPDX-License-Identifier: Apache-2.0
"""`trueup inspect`: what is in these files, what to mind, and a mapping to edit where a guess is wrong."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape

from trueup.articulated.pose import is_quaternion
from trueup.commands.console import notes, tell
from trueup.commands.sources import MAPPING, add_shared, mapping_for, readable, recordings_in
from trueup.commands.suited_mapping import drives_of, labelled, renamed, suited_to
from trueup.errors import ClockError, MappingError
from trueup.formats import ChannelMap, TimeColumn, guess_mapping, read
from trueup.formats.plain import finite
from trueup.formats.rules.joints import SETTINGS
from trueup.formats.table import listing
from trueup.inspection import ChannelInspection, Inspection, inspect
from trueup.inspection.alignment import on_other_clocks
from trueup.model_files.joint_names import joint_names
from trueup.recording import Recording
from trueup.report.numbers import scale_for
from trueup.rounding import SAME_INSTANT
from trueup.units import to_si

ABOUT = """\
Looks at recordings: rate, gaps, jitter, channels and units, encoder grid, noise, what does not move or is cut off.
Guesses which columns are what and writes that as mapping.toml, for you to edit; one that is there is used and kept.

  trueup inspect logs/*.csv
  trueup inspect recordings/* --model robot.xml      also proposes which joint of the file is which of the model
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What this command takes."""
    parser.add_argument(
        "files", nargs="+", metavar="FILE", help="CSV, JSON, NPZ, Parquet, MAT, HDF5, ROS bags, or folders"
    )
    parser.add_argument("--mapping", metavar="FILE", help="read with this mapping instead of guessing")
    add_shared(parser, "rate", "json")
    parser.add_argument("--model", metavar="MODEL", help="compare joint names with this MJCF or URDF, propose renaming")
    parser.add_argument("--write-mapping", metavar="FILE", help="where to write the mapping (default: mapping.toml)",
                        nargs="?", const="mapping.toml")  # fmt: skip
    parser.add_argument("--force", action="store_true", help="guess anew and overwrite the mapping")


def run(args: argparse.Namespace, console: Console, told: Console) -> int:
    """Prints the findings; writes the mapping where there is none. Returns the exit code."""
    paths, said = readable(args.files)
    target = Path(args.write_mapping or MAPPING)
    mapping, more = (None, []) if args.force and not args.mapping else mapping_for(args.mapping or _existing(target))
    said += more
    joints = joint_names(args.model) if args.model is not None else ()
    recordings, other = _read(paths, mapping, args.rate, target, told, named=args.mapping is not None, joints=joints)
    said += other
    of_joints = args.model if joints is not None else None  # a vehicle has none to be named
    guess = None
    if mapping is None and any("reader" in r.provenance for r in recordings):
        guess, more = _guessed(paths, joints, args.rate, recordings, of_joints)
        recordings, said = [_as_named(r, guess.joints) for r in recordings], said + more
    shown, doubts = _seen_by(args.model, recordings, mapping is None) if args.model is not None else (recordings, ())
    said += _unknown(shown, of_joints) if of_joints is not None and mapping is not None else []
    said += [*doubts, *on_other_clocks(shown)]
    found = [inspect(r) for r in shown]
    written = None
    if guess is not None:
        if of_joints is not None:
            guess, more, told_units = suited_to(of_joints, guess, recordings, shown)
            found = [_without_guesses(inspection, told_units) for inspection in found]
            said += more
        said += _others(recordings, target)
        guess.save(target)
        written = target
    if args.json:
        plain = {"recordings": [_plain(f) for f in found], "notes": said, "mapping": str(written or mapping or "")}
        console.print_json(data=plain)
        return 0
    _tell_all(console, found, said, written, mapping)
    return 0


def _tell_all(
    console: Console, found: Sequence[Inspection], said: Sequence[str], written: Path | None, mapping: Path | None
) -> None:
    for inspection in found:
        _show(inspection, console, _shares(written or mapping))
    # The same guess for each file differs in its numbers only; once is enough.
    for guessed in {g.split(" (")[0]: g for inspection in found for g in inspection.guesses}.values():
        tell(console, f"[cyan]guess[/] {escape(guessed)}")
    notes(console, said)
    if written is not None:
        console.print(f"wrote [bold]{escape(str(written))}[/]; edit it if a guess is wrong", soft_wrap=True)
    elif mapping is not None:
        console.print(
            f"{escape(str(mapping))} is kept as it is; --force guesses anew and overwrites it", soft_wrap=True
        )


def _read(
    paths: Sequence[Path],
    mapping: Path | None,
    rate: float | None,
    target: Path,
    told: Console,
    *,
    named: bool,
    joints: Sequence[str] | None,
) -> tuple[list[Recording], list[str]]:
    """The recordings and notes; where nothing but the time of the samples is missing or wrong, the guess is kept for the
    user to fill in.
    """
    if mapping is not None:
        return recordings_in(paths, mapping, told, named=named, joints=joints)
    if rate is not None:
        return read(paths, _with_rate(guess_mapping(paths, joints), rate)), []
    try:
        return recordings_in(paths, None, told, named=False, joints=joints)
    except ClockError as error:
        guess_mapping(paths, joints).save(target)
        raise ClockError(f"{error}. Say so in {target}, which was written with what could be guessed") from None
    except MappingError as error:
        guess = guess_mapping(paths, joints)
        if not guess.time.column and not guess.time.file:
            guess.save(target)
            raise MappingError(
                f"{error}. Give --rate HZ; or fill in rate in {target}, which was written with what could be guessed"
            ) from None
        raise


def _guessed(
    paths: Sequence[Path],
    joints: Sequence[str] | None,
    rate: float | None,
    recordings: Sequence[Recording],
    model: str | None,
) -> tuple[ChannelMap, list[str]]:
    """How the columns become channels, with a model's names for its joints: without these it tells no units; and notes."""
    guess = _with_rate(guess_mapping(paths, joints), rate)
    return (guess, []) if model is None else renamed(guess, recordings, *drives_of(model))


def _as_named(recording: Recording, joints: Mapping[str, str]) -> Recording:
    """With a model's names for the joints that a recording has: others may have more."""
    known = {label for c in recording.channels.values() for label in c.labels}
    return recording.rename({old: new for old, new in joints.items() if old in known})


def _with_rate(guess: ChannelMap, rate: float | None) -> ChannelMap:
    if rate is None:
        return guess
    if not rate > 0.0:
        raise MappingError(f"--rate {rate:g}: samples per second must be above zero")
    return dataclasses.replace(guess, time=TimeColumn(rate=rate))


def _existing(target: Path) -> str | None:
    return str(target) if target.is_file() else None


def _seen_by(model: str, recordings: Sequence[Recording], guessed: bool) -> tuple[Sequence[Recording], tuple[str, ...]]:
    """Recordings with a model's names and units, metres where a joint slides, and what they show to be wrong in it. Where
    the mapping is a guess, units of inertial units that the numbers tell are part of it.
    """
    from trueup.engines.family import family_of

    family = family_of(model)
    loaded = family.load(Path(model))
    named = family.in_units(loaded, recordings, guessed=guessed)
    return named, family.doubts(loaded, named)


def _unknown(recordings: Sequence[Recording], model: str) -> list[str]:
    joints, others = drives_of(model)
    strange = [label for label in labelled(recordings) if label not in joints and label not in others]
    said = f"{Path(model).name} has no joint {', '.join(strange)}; its joints are: {', '.join(joints)}"
    return [said] if strange else []


def _without_guesses(inspection: Inspection, channels: Collection[str]) -> Inspection:
    """Without what was guessed of the unit of channels whose unit the model told."""
    kept = tuple(g for g in inspection.guesses if g.partition(":")[0] not in channels)
    return dataclasses.replace(inspection, guesses=kept)


def _others(recordings: Sequence[Recording], target: Path) -> list[str]:
    """Says which recordings the mapping of the first one does not read."""
    others = [r.name for r in recordings if set(r.channels) != set(recordings[0].channels)]
    if not others:
        return []
    return [
        f"{target} is of '{recordings[0].name}', not of {listing(others, 6)}, whose channels are others. "
        "Files that hold a part of one run each (commands, poses) are one recording in a folder of their own: give the folder"
    ]


def _shares(mapping: Path | None) -> Collection[str]:
    """Channels of which a mapping says that their numbers are shares (%, permille): no unit, and none is missing."""
    channels = {} if mapping is None else ChannelMap.load(mapping).channels
    return {name for name, c in channels.items() if any(u and not to_si(u)[0] for u in c.units or (c.unit,))}


def _show(inspection: Inspection, console: Console, shares: Collection[str]) -> None:
    first = inspection.channels[0] if inspection.channels else None
    rate = f" at {first.rate:.4g} Hz" if first is not None and math.isfinite(first.rate) else ""
    gaps = sum(len(c.gaps) - c.dropped for c in inspection.channels[:1])
    detail = (
        f" (jitter {1e3 * _beyond_rounding(first.jitter):.2g} ms, {gaps or 'no'} gap{'s' * (gaps != 1)})"
        if first is not None
        else ""
    )
    tell(console, f"[bold]{escape(inspection.name)}[/]   {inspection.duration:.1f} s{rate}{detail}")
    for channel in inspection.channels:
        tell(console, f"  {escape(channel.name):13} {_line(channel, shares)}")
    for sentence in inspection.findings():
        tell(console, f"  [yellow]mind[/] {escape(sentence)}")


def _beyond_rounding(jitter: float) -> float:
    return 0.0 if jitter < SAME_INSTANT else jitter


_UNITLESS = {"load": "of what it is rated for"}


def _line(channel: ChannelInspection, shares: Collection[str]) -> str:
    if channel.name in SETTINGS:
        return escape(f"{_span(channel)}, settings of the servos   [{_listed(channel)}]")
    units = channel.units or (channel.unit,) * len(channel.labels)
    unsaid = "unit unknown: say it in the mapping"
    if is_quaternion(channel.labels):
        unsaid = "of a quaternion"
    elif np.array_equal(channel.lowest, channel.highest):  # no unit tells anything of what never changes
        unsaid = f"{_span(channel)} all along"
    none = _UNITLESS.get(channel.name, unsaid)
    if channel.name.startswith("command") and all(
        _is_share(x) for x, u in zip(channel.labels, units, strict=True) if not u
    ):
        none = "share of the full one"
    if channel.name in shares:
        none = "share"
    said = [f"{units.count(u)} x {u or none}" for u in dict.fromkeys(units)]
    parts = [" and ".join(said)]
    same = [u == channel.unit for u in units]  # a step in m says nothing of one in rad
    steps = [g for g, usual in zip(channel.grid, same, strict=True) if g and usual]
    noise = [float(n) for n, usual in zip(channel.noise, same, strict=True) if math.isfinite(n) and n > 0 and usual]
    if steps and not channel.name.startswith("command"):
        scale = scale_for(channel.unit, steps)
        name = "rounded to" if _is_decimal(min(steps), channel.unit) else "encoder grid"
        parts.append(f"{name} {scale.text(min(steps))} {scale.unit}")
    if noise and not channel.name.startswith("command"):
        scale = scale_for(channel.unit, noise)
        parts.append(f"noise {scale.text(sorted(noise)[len(noise) // 2], 2)} {scale.unit}")
    return escape(", ".join(parts) + f"   [{_listed(channel)}]")


def _is_share(label: str) -> bool:
    """Whether a command without a unit is taken as a share of what a vehicle can, which is no gap of the mapping."""
    return label in ("throttle", "brake", "steering") or label.endswith("_duty")


def _listed(channel: ChannelInspection) -> str:
    return ", ".join(channel.labels[:8]) + (" ..." if len(channel.labels) > 8 else "")


def _span(channel: ChannelInspection) -> str:
    """Between what the values of a channel are."""
    low, high = float(np.nanmin(channel.lowest)), float(np.nanmax(channel.highest))
    return f"{low:g}" if low == high else f"{low:g} ... {high:g}"


def _is_decimal(step: float, unit: str) -> bool:
    """Whether a grid is a power of ten in rad, m or degrees: then the file's digits made it as likely as an encoder."""
    exponents = [math.log10(step), *([math.log10(math.degrees(step))] if unit.startswith("rad") else [])]
    return any(abs(e - round(e)) < 1e-3 for e in exponents)


def _plain(inspection: Inspection) -> dict[str, Any]:
    channels = [
        {
            "name": c.name, "labels": list(c.labels), "unit": c.unit, "units": list(c.units),
            "samples": c.samples, "rate": finite(c.rate),
            "jitter": finite(c.jitter), "gaps": [vars(g) for g in c.gaps], "missing": c.missing.tolist(),
            "lowest": finite(c.lowest.tolist()), "highest": finite(c.highest.tolist()),
            "motionless": list(c.motionless), "saturated": list(c.saturated), "grid": list(c.grid),
            "noise": finite(c.noise.tolist()),
        }
        for c in inspection.channels
    ]  # fmt: skip
    return {"name": inspection.name, "duration": inspection.duration, "channels": channels,
            "findings": list(inspection.findings()), "guesses": list(inspection.guesses)}  # fmt: skip
