# SPDX-License-Identifier: Apache-2.0
"""What recordings show to be wrong or missing in a model or in themselves, and the edit that mends it unless refused."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from trueup.errors import unknown_name
from trueup.recording import Recording

Edit = Callable[[Sequence[Recording]], tuple[list[Recording], list[str]]]
"""Recordings, mended, and what was seen and done in words."""


@dataclass(frozen=True)
class Diagnosis:
    """One finding. Its text says what was seen and what is done about it."""

    name: str
    """By which its edit may be refused."""
    evidence: str
    """What was seen, in words."""
    edit: str = ""
    """What is done about it; '' where the evidence says so."""
    numbers: Mapping[str, float] = field(default_factory=dict)
    """The evidence in numbers, in SI units."""
    refused: bool = False
    """Whether the edit was left undone."""

    def unless(self, refuse: Collection[str]) -> Diagnosis:
        """The same, refused if its name is among `refuse`."""
        return replace(self, refused=self.name in refuse)

    def __str__(self) -> str:
        """Evidence and edit as one sentence."""
        whole = f"{self.evidence}: {self.edit}" if self.edit else self.evidence
        return f"refused, and so not done: {whole}" if self.refused else whole


def few(said: Sequence[str]) -> str:
    """The first few of what may be many, joints or samples, for a note."""
    most = 4
    return ", ".join(said[:most]) + (" ..." if len(said) > most else "")


def check_refused(refuse: Iterable[str], names: Iterable[str]) -> None:
    """Raises UnknownNameError for a name that no diagnosis has."""
    for name in refuse:
        if name not in names:
            raise unknown_name("diagnosis", name, list(names), "what may be refused")


def all_edited(
    recordings: Sequence[Recording], edits: Sequence[tuple[str, Edit]], refuse: Collection[str]
) -> tuple[list[Recording], list[Diagnosis]]:
    """Recordings with one edit after another, unless these are refused, and what they are."""
    result, found = list(recordings), list[Diagnosis]()
    for name, edit in edits:
        result, more = edited(result, name, refuse, edit)
        found += more
    return result, found


def edited(
    recordings: Sequence[Recording], name: str, refuse: Collection[str], edit: Edit
) -> tuple[list[Recording], list[Diagnosis]]:
    """Recordings with an edit, unless that is refused, and what it is."""
    result, notes = edit(recordings)
    found = [Diagnosis(name, note).unless(refuse) for note in notes]
    return (list(recordings) if name in refuse else result), found
