# SPDX-License-Identifier: Apache-2.0
"""A run judged by eyes and a stop watch: the file that an operator fills in for it in place of a log, and how it is read."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from trueup.errors import TrialError, unknown_name
from trueup.trial import Trial
from trueup.watched_run import SIDES, WatchedRun

GENERAL = ("trial", "outcome", "note")
"""Keys of a result.toml of any trial."""
_ENDS = ("fell", "veered", "late", "aborted")
_KEYS = ("seconds", "metres", *_ENDS)


def told_in(said: Mapping[str, object], trial: Trial) -> WatchedRun:
    """What a file says of a run of the trial. Raises TrialError that names key, value and choices, UnknownNameError."""
    if trial.watched is None:
        raise TrialError(
            f"{trial.name} asks for a log; a file of what people saw will do for walks ahead or to a line. It may say "
            'outcome = "fell", "aborted" or "repeat"'
        )
    for key in said:
        if key not in (*_KEYS, *GENERAL):
            raise unknown_name("key", key, (*_KEYS, *GENERAL), "such a file")
    _so("aborted", said)
    if not any(said.get(key, False) is not False for key in _KEYS):
        raise TrialError(f"it says nothing yet of {trial.name}: take the # off what happened ({', '.join(_KEYS)})")
    return WatchedRun(
        _seconds(said.get("seconds", [])), _number("metres", said["metres"]) if "metres" in said else math.nan,
        _side(said.get("fell", False)), _so("veered", said), _so("late", said),
    )  # fmt: skip


def template(trial: Trial) -> str:
    """The file to fill in; '' of a trial that asks for a log."""
    rows = _rows(trial)
    if not rows:
        return ""
    head = [
        f"# {trial.name}: what was seen of this run, in place of a log. Take the # off what happened, fill it in, and copy",
        "# this file into inbox/. A decimal point, no comma; texts in quotes.",
    ]
    width = 2 + max(len(entry) for entry, _, _ in rows)
    return "\n".join([*head, *(f"# {entry:{width}}# {means}" for entry, _, means in rows)]) + "\n"


def hint(name: str, trials: Sequence[Trial]) -> str:
    """What to do where a file of this name is no log that can be read, and one of what was seen would do; '' elsewhere."""
    watched = [t.name for t in trials if t.watched]
    return (
        ""
        if not watched or ".toml" in name.lower()
        else f". A run without a log is told in {watched[0]}.toml, as its sheet says"
    )


def explained(trial: Trial, inbox: str) -> list[str]:
    """The same for the sheet, with examples."""
    rows = _rows(trial)
    if not rows:
        return []
    head = f"With a stop watch and your eyes: fill in {trial.name}.toml, beside this sheet, and copy it into {inbox}/:"
    width = 2 + max(len(example) for _, example, _ in rows)
    return [
        head,
        "",
        *(f"  {example:{width}}{means}" for _, example, means in rows),
        "",
        "With a log of the whole run:",
        "",
    ]


def _rows(trial: Trial) -> list[tuple[str, str, str]]:
    """What may be filled in: empty, as an example, and what it means."""
    watched = trial.watched
    if watched is None:
        return []
    lines, lasts = watched.lines, f"{trial.duration:.4g} s"
    sides = ", ".join(f'"{side}"' for side in SIDES)
    rows: list[tuple[str, str, str]] = []
    if len(lines) == 1:
        rows += [("seconds = ", "seconds = 14.2", f"from the start until it was over the line, {lines[0]:.4g} m ahead")]
    if len(lines) > 1:
        at = ", ".join(f"{x:.4g}" for x in lines)
        example = ", ".join(f"{7.1 * (k + 1):.3g}" for k in range(min(len(lines), 3)))
        rows += [("seconds = []", f"seconds = [{example}]",
                  f"since the start, when it passed the lines {at} m ahead; fewer where it fell before")]  # fmt: skip
    rows += [("metres = ", "metres = 1.2", "how far it had come when it ended otherwise; may be left out")] if lines else [
        ("metres = ", "metres = 2.9", f"how far ahead it was after {lasts}, or where it fell")
    ]  # fmt: skip
    rows += [('fell = ""', 'fell = "forward"', sides)]
    rows += [("veered = true", "veered = true", "it left its lane")] if watched.veered else []
    rows += [("late = true", "late = true", f"it was still on the way after {lasts}")] if lines else []
    return [*rows, ("aborted = true", "aborted = true", "you stopped it; it says nothing about the settings"),
            ('note = ""', 'note = "a shoe was loose"', "anything else")]  # fmt: skip


def _seconds(value: object) -> tuple[float, ...]:
    every = value if isinstance(value, list) else [value]
    return tuple(_number("seconds", x) for x in every)


def _number(key: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TrialError(f"{key} = {value!r} is no number: write {key} = 14.2")
    if not math.isfinite(value):
        raise TrialError(f"{key} = {value} is no number that can be")
    return float(value)


def _side(value: object) -> str:
    if value is False:
        return ""
    if not isinstance(value, str) or value not in SIDES:
        raise TrialError(f"fell = {value!r} is not one of: {', '.join(SIDES)}")
    return value


def _so(key: str, said: Mapping[str, object]) -> bool:
    value = said.get(key, False)
    if not isinstance(value, bool):
        raise TrialError(f"{key} = {value!r} is neither true nor false")
    return value
