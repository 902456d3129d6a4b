# SPDX-License-Identifier: Apache-2.0
"""Every error a user may meet. Each message names the offender, shows its value and lists the choices."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence


class TrueupError(Exception):
    """Base of all errors that trueup raises on purpose; the command line prints the message, not a traceback."""


class RecordingError(TrueupError):
    """A recording cannot be what it says: time runs backward, a channel is missing, shapes disagree."""


class FormatError(RecordingError):
    """A file cannot be read as a recording; the message names file, line and column where they are known."""


class ClockError(FormatError):
    """Time goes back, stands or is missing in rows of a file: a mapping may say how that is mended."""


class MappingError(RecordingError):
    """The mapping from columns to channels does not fit the file."""


class OtherFilesMappingError(MappingError):
    """A mapping names not one column that the file has: it was written for other files."""


class ParameterError(TrueupError):
    """A parameter declaration or a value is impossible (bounds crossed, unknown scale, wrong shape)."""


class ModelError(TrueupError):
    """A robot model cannot be loaded or changed as asked."""


class UnknownNameError(ModelError, RecordingError, ParameterError):
    """A name that does not exist; the message lists those that do."""


class SimulationFailedError(TrueupError):
    """A simulation could not be completed. `failed`: number of a recording, in the order given, to why it broke off."""

    def __init__(self, message: str, failed: Mapping[int, str] | None = None) -> None:
        """`failed`: see the class."""
        super().__init__(message)
        self.failed = dict(failed or {})


class CalibrationError(TrueupError):
    """A calibration cannot start or go on: nothing to fit, no common channel, resumed with another problem."""


class IdentificationError(TrueupError):
    """A dynamic model cannot be identified: no motion, torque that does not fit the joints, impossible settings."""


class GroundingError(TrueupError):
    """A simulator cannot be grounded: nothing to learn from, or what is asked lies outside of what was learned."""


class EvaluationError(TrueupError):
    """Candidates cannot be evaluated where they were to be: no such cluster, none of its workers fit, nothing came back."""


class OutputError(TrueupError):
    """A result could not be written; what was there before is untouched."""


class PlanError(TrueupError):
    """A campaign's plan says something impossible; the message names file, key, value and the choices."""


class JournalError(TrueupError):
    """A campaign's journal cannot be read, belongs to another plan, or is in use by another process."""


class TrialError(TrueupError):
    """A trial cannot be handed out or its outcome used: a limit exceeded, an outcome unknown after an interruption."""


class TrialAbortedError(TrialError):
    """The operator stopped a run; it says nothing about what was tried."""


class RobotFellError(TrialError):
    """The robot fell or failed in a run: what was tried is bad, and is scored so."""


class RenderingError(TrueupError):
    """This machine has no graphics to render pictures with; the message says what to install."""


class MissingExtraError(TrueupError):
    """An optional dependency is absent; the message says which `pip install` mends it."""

    def __init__(self, purpose: str, package: str, extra: str) -> None:
        super().__init__(f"{purpose} needs the package '{package}': pip install 'trueup[{extra}]'")


def unknown_name(kind: str, name: str, known: Iterable[str], where: str = "the model") -> UnknownNameError:
    """The error for a name that does not exist, with the nearest match first and all choices listed.

    `kind` is singular ("joint"), `where` completes "... is not in".
    """
    choices = sorted(set(known))
    close = difflib.get_close_matches(name, choices, n=1)
    hint = f" (did you mean '{close[0]}'?)" if close else ""
    listed = ", ".join(choices[:40]) + (f", ... ({len(choices)} in all)" if len(choices) > 40 else "")
    return UnknownNameError(f"{kind} '{name}' is not in {where}{hint}; {_several(kind)} are: {listed or 'none'}")


def counted(count: int, noun: str) -> str:
    """A number of things: '1 run', '3 runs'."""
    return f"{count} {noun if count == 1 else _several(noun)}"


def listed(names: Sequence[str], most: int = 6) -> str:
    """Names one after the other in a sentence, and how many more there are where `most` of them are enough."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def _several(kind: str) -> str:
    if kind.endswith("sis"):
        return f"{kind[:-2]}es"
    return f"{kind[:-1]}ies" if kind.endswith(("ty", "dy")) else f"{kind}s"
