# SPDX-License-Identifier: Apache-2.0
"""How robots of one family are prepared, calibrated, compared, written and described; which family a model file is of.

`FAMILIES` is the only place where the ending of a file says anything. Other packages add a family by an entry point of the
group 'trueup.families', named by the ending of its files ('.sdf') and leading to a class.
"""

from __future__ import annotations

import importlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from trueup.arrays import Array
from trueup.calibration import Calibration, Prediction, Replay, by_unit
from trueup.discrepancies.discrepancy import Discrepancy
from trueup.engines.simulator import Simulator
from trueup.errors import ModelError, unknown_name
from trueup.extensions import registered
from trueup.inspection.diagnosis import Diagnosis
from trueup.recording import Recording

FAMILIES = {"": "trueup.engines.mujoco.family:Articulated", ".toml": "trueup.engines.vehicle.family:Vehicles"}
"""Ending of a model file -> class of its family; '' for all others."""
ENGINES = {"mujoco": "trueup.engines.mujoco.family:Articulated", "dart": "trueup.engines.dart.family:DartRobots"}
"""Name of an engine -> class of the family of robots of joints and links that it simulates; the first unless one is named."""
GROUP = "trueup.families"

Note = str | Diagnosis
"""What was done to model and recordings: a sentence, or what may be refused by its name."""


class Fit(Protocol):
    """`trueup.loop.calibrate` with the options that a user gave: what a family calibrates with, in its own way."""

    def __call__(
        self, simulator: Simulator, recordings: Sequence[Recording], hold_out: Sequence[Recording] = (), *,
        discrepancy: Discrepancy | None = None, cross_validate: bool = True, again: bool = False,
        without: Collection[str] = (), start: Array | None = None,
    ) -> Calibration:  # fmt: skip
        """See `calibrate`. `again`: a fit after the first, which is neither kept for an interruption nor resumed;
        `without` these stages of the search, by name; from values `start` (n,), unless an earlier calibration has some.
        """
        ...


@dataclass(frozen=True)
class Request:
    """What is asked of a simulator beside its model file."""

    parameters: Path | None = None
    """Declares what is calibrated; None: what the recordings propose."""
    propose: bool = True
    """False: the model as it is, without parameters, unless a file declares some."""
    beyond_mjcf: bool = False
    """Propose friction that MJCF has no place for too."""
    step: float | None = None
    """Integration step in s; None: the family's own."""
    clocks: Mapping[str, float] = field(default_factory=dict)
    """How late the commands of some recordings are stamped, in s."""
    refuse: frozenset[str] = frozenset()
    """Diagnoses whose edits are not wanted, by name."""


@dataclass(frozen=True)
class Suited:
    """Recordings as a model can take them, and what was changed in them, in words."""

    training: tuple[Recording, ...]
    held_out: tuple[Recording, ...] = ()
    notes: tuple[Note, ...] = ()


class Family:
    """What may differ from family to family; these are the answers for a simulator of which nothing more is known."""

    suffix = ".xml"
    """Of the file that holds a calibrated model."""
    describes = "a model file of the same kind"
    """What such a file is, in words."""
    compares = "no joint and no sensor of the model"
    """What a channel is that its simulators have nothing to compare with, in words."""
    diagnoses: tuple[str, ...] = ()
    """Names of what is diagnosed, whose edits may be refused."""

    def load(self, path: Path) -> Any:
        """The model in a file, in whatever form the other methods take it. Raises ModelError."""
        raise ModelError(f"{path}: this family has no model files")

    def drives(self, model: Any) -> Mapping[str, str]:
        """A model's joints, each to the name of what drives it, '' where nothing does; in the order in which a log counts."""
        return {}

    def others(self, model: Any) -> tuple[str, ...]:
        """A model's drives that turn several joints at once."""
        return ()

    def sensors(self, model: Any) -> Mapping[str, str]:
        """A model's sensors of three numbers, each to the unit of what it measures (see `inspection.sensors`)."""
        return {}

    def in_units(
        self, model: Any, recordings: Sequence[Recording], *, guessed: bool = False
    ) -> Sequence[Recording]:  # fmt: skip
        """Recordings with a model's names and units, not yet made ready to be replayed: for those who look at them. With
        units of sensors that their numbers alone tell where all is `guessed`, for a user to edit.
        """
        return recordings

    def doubts(self, model: Any, recordings: Sequence[Recording]) -> tuple[str, ...]:
        """What recordings with the model's names and units show to be hardly right in the model, which nothing mends."""
        return ()

    def reads(self, recording: Recording) -> Collection[str]:
        """Measured channels that make a recording ready without being compared."""
        return ()

    def following(self, simulator: Any, recordings: Sequence[Recording]) -> Any:
        """The same simulator for other recordings, where it takes anything from those that it was made for."""
        return simulator

    def suited(
        self,
        model: Any,
        training: Sequence[Recording],
        held_out: Sequence[Recording] = (),
        refuse: Collection[str] = (),
    ) -> Suited:
        """Recordings with the model's names and units. Raises ModelError, RecordingError."""
        return Suited(tuple(training), tuple(held_out))

    def simulator(
        self, model: Any, training: Sequence[Recording], replayed: Sequence[Recording], request: Request
    ) -> tuple[Simulator, tuple[Note, ...]]:
        """The simulator of a model with its parameters, as recordings (`suited`) need it, and what was done, in words.

        `replayed` will be replayed too, but propose nothing. Raises ModelError, ParameterError, UnknownNameError.
        """
        raise ModelError("this family has no model files")

    def torques(self, simulator: Any, recordings: Sequence[Recording]) -> tuple[Any, Sequence[Recording]]:
        """An arm's kinematic tree, as `identification` has it, and recordings with joint torques in place of commands; None
        and () unless commands tell them, of all.
        """
        return None, ()

    def for_whole_runs(self, simulator: Any) -> Simulator:
        """A simulator with what whole runs of a robot with a free base tell, where nobody declared what to calibrate."""
        return simulator

    def calibrate(
        self, simulator: Any, training: Sequence[Recording], held_out: Sequence[Recording], fit: Fit
    ) -> Calibration:
        """Calibrates a simulator in the family's way. Raises what `calibrate` raises."""
        return fit(simulator, training, held_out)

    def as_recorded(self, replays: Sequence[Replay], recordings: Sequence[Recording]) -> tuple[Replay, ...]:
        """Replays of `suited` recordings as the recordings were: one unit each."""
        return by_unit(replays, recordings)

    def known_before(self, simulator: Any) -> bool:
        """Whether the model as it was given can be compared with: False where what drives it had to be guessed."""
        return True

    def judged(self, simulator: Any, recordings: Sequence[Recording]) -> tuple[Recording, ...]:
        """Recordings without what a simulator as it is should not be judged by."""
        return tuple(recordings)

    def predictions(
        self, simulator: Any, against: Any, recordings: Sequence[Recording]
    ) -> tuple[tuple[Prediction, ...], tuple[str, ...]]:
        """How a family that is judged some seconds ahead does on `recordings`, and notes; () where replays judge."""
        return (), ()

    def write(
        self, simulator: Any, calibration: Calibration, model: Path, parameters: Path
    ) -> tuple[str, ...]:  # fmt: skip
        """Writes the calibrated model, and its parameters where the model cannot hold them all; notes on what is lost.

        Raises OutputError and ModelError; older files are untouched then.
        """
        raise ModelError(f"the calibrated model of '{simulator.name}' has no file")

    def usage(self, simulator: Any, calibration: Calibration, model: Path) -> tuple[str, ...]:
        """Lines of code that simulate the written `model` as it was fitted; () for none."""
        return ()

    def kinds(self, simulator: Any) -> tuple[tuple[str, str, int], ...]:
        """(quantity, kind of element, number of elements) of the free parameters, in order: what a summary says of them."""
        return tuple((p.name, simulator.name, 1) for p in simulator.parameters.parameters if not p.frozen)

    def advice(self, simulator: Any, calibration: Calibration | None = None) -> tuple[str, ...]:
        """What to mind before a calibration (None), or what might be tried after it."""
        return ()


def family_of(model: str | Path, engine: str = "") -> Family:
    """The family of a model file, by its ending, simulated by one of ENGINES where it can be had in several.

    Raises UnknownNameError for another engine, ModelError for a file that has an engine of its own.
    """
    others = {name.lower(): address for name, address in registered(GROUP).items()}
    if engine and engine not in ENGINES:
        raise unknown_name("engine", engine, ENGINES, "what simulates robots of joints and links")
    suffix, known = Path(model).suffix.lower(), {**others, **FAMILIES}
    if engine and suffix in known:
        raise ModelError(f"{model}: files ending in '{suffix}' are simulated in a way of their own, not by '{engine}'")
    address = known.get(suffix, ENGINES[engine or "mujoco"])
    module, _, name = address.partition(":")
    return getattr(importlib.import_module(module), name)()
