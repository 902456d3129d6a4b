# SPDX-License-Identifier: Apache-2.0
"""From what stands on the command line to recordings: paths, the mapping that lies there, which ones are held out."""

from __future__ import annotations

import argparse
import fnmatch
import re
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, DownloadColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from trueup import files
from trueup.errors import FormatError, MappingError, OtherFilesMappingError, RecordingError, unknown_name
from trueup.formats import ChannelMap, guess_mapping, is_recording, read
from trueup.formats.distinct import distinct
from trueup.inspection.diagnosis import Diagnosis
from trueup.model_files.joint_names import joint_names
from trueup.recording import Recording, part_of
from trueup.trial import ENABLED, command_of, drives_off

Mapped = ChannelMap | Path | None
"""What says how columns become channels; None: guessed."""
MAPPING = Path("mapping.toml")
"""The mapping that is used when none is named, in the current folder."""


def readable(paths: Sequence[str]) -> tuple[list[Path], list[str]]:
    """The paths that may be recordings, and notes on those left out (a licence, a picture). Raises FormatError."""
    given = [Path(p) for p in paths]
    for path in given:
        if not path.is_dir():
            files.check(path, FormatError)
    kept = [p for p in given if is_recording(p)] or given
    left = [p.name for p in given if p not in kept]
    return kept, [f"left out, no recordings: {', '.join(left)}"] if left else []


def mapping_for(named: str | None) -> tuple[Path | None, list[str]]:
    """The mapping file to read with, and a note where it was found rather than named."""
    if named is not None:
        return Path(named), []
    if MAPPING.is_file():
        return MAPPING, [f"columns are read as {MAPPING} in this folder says"]
    return None, []


def recordings_in(
    paths: Sequence[Path],
    mapping: Mapped,
    told: Console | None = None,
    *,
    named: bool,
    joints: Sequence[str] | None = (),
) -> tuple[list[Recording], list[str]]:
    """The recordings in files, and notes. A mapping that was found rather than `named` is not used for files of which it
    names no column: theirs are guessed, `joints` by their exact names. What takes a while is shown on `told`.

    Raises what `formats.read` raises.
    """
    recordings: list[Recording] = []
    others: list[str] = []
    for path in _shown(paths, told):
        try:
            recordings += read([path], mapping, joints)
        except OtherFilesMappingError:
            if named:
                raise
            recordings += read([path], joints=joints)
            others.append(path.name)
        except MappingError as error:
            if named or not MAPPING.is_file():
                raise
            raise MappingError(
                f"{error}. {MAPPING} in this folder says so: edit it, name another one by --mapping, or move it away to have "
                "columns guessed"
            ) from None
    more = f"{mapping} names no column of {', '.join(others[:5])}{' ...' * (len(others) > 5)}: theirs are guessed"
    return distinct(recordings), [more] if others else []


def _shown(paths: Sequence[Path], told: Console | None) -> Iterator[Path]:
    """The paths, with a bar on a terminal that says which is being read, by bytes, where they are large."""
    large = 5_000_000  # Bytes that take longer to read than one likes to wait without a word
    if told is None or not told.is_terminal:
        yield from paths
        return
    each = ([p] if p.is_file() else [f for f in p.rglob("*") if f.is_file()] for p in paths)
    sizes = [sum(f.stat().st_size for f in files_in) for files_in in each]
    if sum(sizes) < large:
        yield from paths
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(24), DownloadColumn(), TimeElapsedColumn())
    with Progress(*columns, console=told, transient=True) as bar:
        task = bar.add_task("reading", total=sum(sizes))
        for path, size in zip(paths, sizes, strict=True):
            bar.update(task, description=f"reading {escape(path.name)}")
            yield path
            bar.advance(task, size)


def given(
    args: argparse.Namespace, told: Console | None = None, *, hold_out: Sequence[str] | None = None,
    rated: Callable[[ChannelMap], ChannelMap] | None = None, driven: bool = True,
) -> tuple[list[Recording], list[Recording], list[str]]:  # fmt: skip
    """The recordings that a command line names, those held out (None: as it says), and notes on what was done.

    `rated` gives the mapping a rate where one is asked for; `driven`: cut to where the drives were on. Raises what
    `readable`, `recordings_in` and `split` raise.
    """
    paths, notes = readable(args.recordings)
    mapping, more = mapping_for(args.mapping)
    joints = joint_names(args.model) if getattr(args, "model", None) else ()

    def loaded(paths: Sequence[Path]) -> list[Recording]:
        columns: Mapped = mapping
        if rated is not None:
            columns = rated(ChannelMap.load(mapping) if mapping else guess_mapping(paths, joints))
        found, others = recordings_in(paths, columns, told, named=args.mapping is not None, joints=joints)
        found, off = while_driven(found) if driven else (found, [])
        more.extend([*others, *off])
        return found

    held = getattr(args, "hold_out", ()) if hold_out is None else hold_out
    training, kept = split(loaded(paths), held, loaded)
    return training, kept, [*notes, *more]


def split(
    recordings: Sequence[Recording],
    hold_out: Sequence[str],
    loaded: Callable[[Sequence[Path]], list[Recording]],
) -> tuple[list[Recording], list[Recording]]:
    """Recordings to fit and recordings to hold out: by name, by pattern, by path among those given, or further paths; of a
    share in percent the ends of those that are fitted. `loaded` reads further paths.

    Raises UnknownNameError for what is none of these, RecordingError for a share that leaves nothing.
    """
    held: list[Recording] = []
    shares = [0.01 * float(found[1]) for entry in hold_out if (found := SHARE.fullmatch(entry))]
    for entry in (e for e in hold_out if not SHARE.fullmatch(e)):
        found = [r for r in (*recordings, *held) if fnmatch.fnmatchcase(r.name, entry) or _comes_from(r, Path(entry))]
        if not found and Path(entry).exists():
            found = loaded([Path(entry)])
        if not found:
            raise unknown_name("recording", entry, [r.name for r in recordings], "those given (nor a file or folder)")
        held += [r for r in found if all(r is not h for h in held)]
    fitted = [r for r in recordings if all(r is not h for h in held)]
    named = distinct([*fitted, *held])
    fitted, held = named[: len(fitted)], named[len(fitted) :]
    if not shares:
        return fitted, held
    parts = [_parted(r, shares[-1]) for r in fitted]
    return [begin for begin, _ in parts], [*held, *(end for _, end in parts)]


def _parted(recording: Recording, share: float) -> tuple[Recording, Recording]:
    """A recording without its last `share`, and that."""
    k = len(recording.time) - round(share * len(recording.time))
    if not 1 < k < len(recording.time) - 1:
        raise RecordingError(
            f"--hold-out {100 * share:g}%: of the {len(recording.time)} samples of recording '{recording.name}' both parts "
            "need two or more"
        )
    end = recording.slice(float(recording.time[k]), recording.stop)
    begin = recording.slice(recording.start, float(recording.time[k - 1]))
    return begin, end.replace(name=f"{recording.name}_end", provenance=part_of(end))


def while_driven(recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings that log whether their drives were on (`torque_enable`), cut to the longest stretch with all on that ever
    are.

    A drive that is off does not follow its command, which a simulator knows nothing of; a log without commands, all drives
    off, stays. With notes on what was cut.
    """
    kept, notes = [], []
    for recording in recordings:
        if not recording.has(ENABLED) or (drives_off(recording) and command_of(recording) is None):
            kept.append(recording)
            continue
        channel = recording.channel(ENABLED)
        each = np.nan_to_num(channel.values) != 0.0
        on = np.concatenate([[False], each[:, each.any(axis=0)].all(axis=1) & each.any(), [False]])
        edges = np.flatnonzero(np.diff(on.astype(int))).reshape(-1, 2)
        lengths = [channel.time[b - 1] - channel.time[a] for a, b in edges]
        if not lengths:
            raise RecordingError(f"recording '{recording.name}': its drives are off all the time ('{ENABLED}')")
        first, behind = edges[int(np.argmax(lengths))]
        if behind - first == len(channel.time):
            kept.append(recording)
            continue
        start, stop = float(channel.time[first]), float(channel.time[behind - 1])
        notes.append(
            f"'{recording.name}' is cut to {start - recording.start:.2f} ... {stop - recording.start:.2f} s of "
            f"{recording.duration:.2f} s: its drives are off in the rest ('{ENABLED}')"
        )
        kept.append(recording.slice(start, stop))
    return kept, notes


def typed(args: argparse.Namespace) -> str:
    """The command that was typed, to be typed again."""
    return shlex.join(["trueup", *args.command_line])


def made_by(args: argparse.Namespace) -> dict[str, str]:
    """What made a report, for its last section."""
    return {"command": typed(args), "python": sys.version.split()[0]}


def seed_of(text: str) -> int:
    """A seed of random numbers. Raises ArgumentTypeError for what is none."""
    if not (text.isascii() and text.isdecimal()):
        raise argparse.ArgumentTypeError(f"a seed is a whole number, 0 or above, not '{text}'")
    return int(text)


_HOLD_OUT = "recordings to judge by and not to fit: names, patterns ('fast_*'), paths; '30%%': the end of each"
SHARE = re.compile(r"(\d+(?:\.\d+)?)\s*%")
"""A share of each recording, as `--hold-out` takes it."""
_SHARED: Mapping[str, tuple[tuple[str, ...], Mapping[str, Any]]] = {
    "recordings": (("recordings",), {"nargs": "+", "metavar": "RECORDING", "help": "files or folders"}),
    "folder": (("folder",), {"nargs": "?", "default": ".", "metavar": "DIR",
                             "help": "the campaign's folder (default: this one)"}),
    "out": (("--out",), {"required": True, "metavar": "DIR", "help": "folder for the results; the next run takes DIR-2"}),
    "hold-out": (("--hold-out",), {"nargs": "+", "action": "extend", "default": [], "metavar": "NAME", "help": _HOLD_OUT}),
    "mapping": (("--mapping",), {"metavar": "FILE", "help": "how columns become channels (default: mapping.toml if here)"}),
    "rate": (("--rate",), {"type": float, "metavar": "HZ", "help": "samples per second, for logs without a column of time"}),
    "seed": (("--seed",), {"type": seed_of, "default": 0, "metavar": "N", "help": "of all random numbers (default: 0)"}),
    "json": (("--json",), {"action": "store_true", "help": "print the outcome as JSON, for scripts"}),
    "force": (("--force",), {"action": "store_true", "help": "replace what is in DIR"}),
    "quiet": (("-q", "--quiet"), {"action": "store_true", "help": "no progress, no notes"}),
}  # fmt: skip


def add_shared(parser: argparse.ArgumentParser, *names: str) -> None:
    """Options that several commands have, by their names."""
    for name in names:
        flags, how = _SHARED[name]
        parser.add_argument(*flags, **how)


def add_engine(parser: argparse.ArgumentParser) -> None:
    """The option that says what simulates."""
    parser.add_argument("--engine", default="", choices=("mujoco", "dart"),
                        help="what simulates an MJCF or URDF: mujoco (default), or dart, whose contacts are others and which "
                             "is slower by far (pip install 'trueup[dart]')")  # fmt: skip


def add_refuse(parser: argparse.ArgumentParser) -> None:
    """The option that refuses what was diagnosed."""
    parser.add_argument("--refuse", nargs="+", action="extend", default=[], metavar="NAME",
                        help="leave as it is what the recordings show to be wrong or missing: tendons, names, strangers "
                             "(joints), spikes, torques, sensors, turns, gains, feedforward, heights, feet (telling "
                             "where the base was), pauses, released, lifts, base, servos, gravity, overlaps, "
                             "ranges, still (joints), floor, stops, zero, clock, disturbed")  # fmt: skip


def refusable(diagnoses: Sequence[Diagnosis]) -> tuple[str, ...]:
    """A note on which of the edits that were made may be refused."""
    names = dict.fromkeys(d.name for d in diagnoses if not d.refused)
    return (f"not so? refuse it by name: --refuse {' '.join(names)}",) if names else ()


def step_of(text: str) -> float:
    """An integration step in s. Raises ArgumentTypeError for what is none."""
    try:
        step = float(text)
    except ValueError:
        step = float("nan")
    if not 1e-5 <= step <= 0.02:
        raise argparse.ArgumentTypeError(f"a step is a number from 0.00001 to 0.02 s (0.001 is 1 ms), not '{text}'")
    return step


def _comes_from(recording: Recording, path: Path) -> bool:
    sources = recording.provenance.get("source", "").split("\n")
    if not path.exists():
        return False
    there = path.resolve()
    return any(s and (Path(s).resolve() == there or there in Path(s).resolve().parents) for s in sources)
