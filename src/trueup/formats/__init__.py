# SPDX-License-Identifier: Apache-2.0
"""Recordings from and to files. CSV, JSON, NPZ, Parquet, MAT, HDF5 and ROS bags come in; one Parquet file goes out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from trueup.errors import FormatError, OutputError, RecordingError, UnknownNameError
from trueup.formats import parquet
from trueup.formats.assembly import assemble
from trueup.formats.distinct import distinct
from trueup.formats.mapping import ChannelColumns, ChannelMap, TimeColumn
from trueup.formats.rules.engine import guess
from trueup.formats.source import Source, checksums, is_recording, sources
from trueup.recording import Recording

__all__ = ["ChannelColumns", "ChannelMap", "TimeColumn", "guess_mapping", "is_recording", "read", "write"]

_SLOWEST, _FASTEST = 1e-3, 1e6
"""Hz: from one sample in a quarter of an hour to what oscilloscopes do."""
Paths = str | Path | Sequence[str | Path]


def read(
    source: Paths, mapping: ChannelMap | str | Path | None = None, joints: Sequence[str] | None = ()
) -> list[Recording]:
    """The recordings in files and folders, in SI units.

    A file is one recording. A folder is one recording if its files complement each other (commands in one, states in
    another), one for each file if they are alike, and one for each folder in it if it has no files to read. A ROS
    bag is one recording. Files of one name have their folders' in theirs. `mapping` (or the TOML file that holds it)
    says how columns become channels; without it that is guessed, and provenance['guesses'] says what was not sure.
    provenance['warnings'] says what was left out. `joints`: those of the robot's model, whose exact names mean nothing
    else then (an arm's "base_yaw"); None for a vehicle's, which has none: what else a log holds, of an arm that rides
    on it, is not what drives it.

    Raises FormatError (naming file, line, column and value) for unsound files, MappingError where mapping and file do
    not fit, MissingExtraError where reading needs a package that is not installed.
    """
    known = ChannelMap.load(mapping) if isinstance(mapping, (str, Path)) else mapping
    how = "guessed" if mapping is None else str(mapping) if isinstance(mapping, (str, Path)) else "given"
    return distinct([_recording(found, known, how, joints) for found in _sources(source, known)])


def write(recording: Recording, path: str | Path) -> None:
    """Writes a recording as one Parquet file, with units, labels, instants and provenance; `read` gives it back.

    It is written aside and renamed. Raises OutputError (full disk, no permission, a name of another format); what was there
    before is untouched.
    """
    if (suffix := Path(path).suffix.lower()) not in (".parquet", ".pq", ""):
        raise OutputError(
            f"{path}: a recording is written as Parquet, which keeps units and instants, not as '{suffix}'; name it "
            f"'{Path(path).stem}.parquet' (`trueup replay --trajectories csv` writes tables)"
        )
    parquet.write(recording, Path(path))


def guess_mapping(source: Paths, joints: Sequence[str] | None = ()) -> ChannelMap:
    """The mapping that `read` would guess for the first recording in `source`; its `notes` say what is not sure.

    Raises FormatError for unsound files, and MappingError where there is nothing to guess from.
    """
    for path in [source] if isinstance(source, (str, Path)) else source:
        for found in _sources(path, None):
            if found.tables:
                return guess(found.tables, joints)
    raise FormatError(f"{source}: these files are recordings of trueup already and need no mapping")


def _check_sampled(recording: Recording) -> None:
    """Raises FormatError for a channel that is no signal: of too few samples, or at a rate that nothing is sampled at."""
    fewest = 3  # Samples without which there is neither speed nor rate
    for channel in recording.channels.values():
        where = f"'{recording.name}', channel '{channel.name}'"
        if len(channel.time) < fewest:
            count = f"{len(channel.time)} sample{'s' * (len(channel.time) != 1)}"
            raise FormatError(f"{where}: {count}; at least {fewest} are needed to tell how it moves")
        rate = (len(channel.time) - 1) / float(channel.time[-1] - channel.time[0])
        if not _SLOWEST <= rate <= _FASTEST:
            raise FormatError(
                f"{where}: {rate:.3g} samples per second, as nothing is sampled; say in [time] of the mapping which unit "
                "the times have"
            )


def _sources(source: Paths, mapping: ChannelMap | None) -> list[Source]:
    paths = [source] if isinstance(source, (str, Path)) else list(source)
    if not paths:
        raise FormatError("no file was given to read")
    together = mapping is not None and any(entry.file for entry in mapping.channels.values())
    return sources(paths, together=together)


def _recording(found: Source, mapping: ChannelMap | None, how: str, joints: Sequence[str] | None) -> Recording:
    if found.recording is not None:
        names = dict(mapping.joints) if mapping is not None else {}
        present = {label for channel in found.recording.channels.values() for label in channel.labels}
        renamed = {old: new for old, new in names.items() if old in present}
        return found.recording.rename(renamed) if renamed else found.recording
    provenance = {
        "source": "\n".join(str(path) for path in found.paths),
        "reader": found.reader,
        "mapping": how,
        **{f"sha256 of {name}": digest for name, digest in checksums(found.paths).items()},
    }
    used = guess(found.tables, joints) if mapping is None else mapping
    try:
        recording = assemble(found.tables, used, found.name, provenance)
    except (RecordingError, UnknownNameError) as error:
        if how in ("guessed", "given"):
            raise
        raise type(error)(f"{error} (columns are read as {how} says)") from None
    _check_sampled(recording)
    if mapping is not None or not used.notes:
        return recording
    return recording.replace(provenance={**recording.provenance, "guesses": "\n".join(used.notes)})
