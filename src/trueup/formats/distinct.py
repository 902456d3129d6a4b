# SPDX-License-Identifier: Apache-2.0
"""Recordings from folders in which files have the same names: a name for each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from trueup.recording import Recording


def distinct(recordings: Sequence[Recording]) -> list[Recording]:
    """Recordings of which no two have one name: those that did are named after their folders as well.

    Of day_1/run/log.csv and day_2/run/log.csv comes 'day_1_log' and 'day_2_log'; of several from one file 'log', 'log_2'.
    """
    counts = Counter(r.name for r in recordings)
    alike = {name: _parting([r for r in recordings if r.name == name]) for name, n in counts.items() if n > 1}
    taken = {name for name, n in counts.items() if n == 1}
    named = []
    for recording in recordings:
        if recording.name not in alike:
            named.append(recording)
            continue
        name = first = "_".join((*alike[recording.name].pop(0), recording.name))
        number = 1
        while name in taken:
            number += 1
            name = f"{first}_{number}"
        taken.add(name)
        named.append(recording.replace(name=name))
    return named


def _parting(recordings: Sequence[Recording]) -> list[tuple[str, ...]]:
    """Of each, those of the folders that it lies in which not all lie in."""
    folders = [Path(r.provenance.get("source", "").split("\n")[0]).resolve().parent.parts for r in recordings]
    shared = max(k for k in range(min(map(len, folders)) + 1) if len({f[:k] for f in folders}) == 1)
    inner = [f[shared:] for f in folders]
    common = max(k for k in range(min(map(len, inner)) + 1) if len({f[len(f) - k :] for f in inner}) == 1)
    return [f[: len(f) - common] for f in inner]
