# SPDX-License-Identifier: Apache-2.0
"""From a model file and recordings to what can be calibrated, compared and written: the same for everyone who asks."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Ahead, Calibration, Prediction, Replay
from trueup.discrepancies.discrepancy import Discrepancy
from trueup.discrepancies.weighted import Weighted
from trueup.ends import End
from trueup.engines.family import Family, Note, Request, family_of
from trueup.engines.simulator import Respaced, Simulator
from trueup.errors import CalibrationError, ModelError, SimulationFailedError, unknown_name
from trueup.inspection.alignment import clock_errors
from trueup.inspection.diagnosis import Diagnosis, check_refused
from trueup.inspection.outstanding import NAME
from trueup.inspection.released import LONG
from trueup.inspection.si import in_si
from trueup.loop.ahead import predicted_ahead
from trueup.loop.calibrate import Options, calibrate, usual
from trueup.loop.disturbed import deviations_in, disturbed
from trueup.loop.earlier import Earlier
from trueup.loop.fit import Checkpoint, Progress, searched_by
from trueup.loop.problem import Problem
from trueup.loop.pushed import pushed
from trueup.loop.recalibrate import recalibrate
from trueup.loop.replay import replays
from trueup.loop.restricted import Restricted
from trueup.loop.whole_calibration import calibrate_whole
from trueup.loop.worth import Choice, worth_calibrating
from trueup.parameters import ParameterSpace
from trueup.reckoned import TOLD_BY, reckoned_of
from trueup.recording import Recording, is_command


@dataclass(frozen=True)
class Comparison:
    """How a model does as it is on recordings, another one beside it if wanted (`before` and `against`)."""

    replays: tuple[Replay, ...] = ()
    predictions: tuple[Prediction, ...] = ()
    """For families that are judged some seconds ahead."""
    ahead: tuple[Ahead, ...] = ()
    """Of the model: errors one sample, 0.1 s and 1 s after each of many starts."""
    notes: tuple[str, ...] = ()
    failed: tuple[tuple[Recording, str], ...] = ()
    """Recordings of which the simulation broke off, or was refused, and why; they are in nothing else here."""


@dataclass(frozen=True, eq=False)
class Preparation:
    """A simulator and recordings that fit together, ready to be calibrated or compared."""

    family: Family
    simulator: Simulator
    recordings: tuple[Recording, ...]
    """To fit, with the model's names and units."""
    hold_out: tuple[Recording, ...] = ()
    """To judge by."""
    findings: tuple[Note, ...] = ()
    """What was seen and changed in model and recordings."""
    refuse: frozenset[str] = frozenset()
    """Names of diagnoses whose edits were not wanted."""
    model: Any = None
    """The model as it was read from its file; None where there is no file."""
    later: Callable[[Sequence[Recording]], Preparation] | None = None
    """Makes it anew with what recordings propose to calibrate, where nothing is declared and nothing was recorded yet."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What was changed in model and recordings, and what to mind, in words."""
        return tuple(str(note) for note in self.findings)

    @property
    def diagnoses(self) -> tuple[Diagnosis, ...]:
        """What recordings show to be wrong or missing, with the edits made; refused by name with `prepare(refuse=...)`."""
        return tuple(note for note in self.findings if isinstance(note, Diagnosis))

    def calibrate(
        self, options: Options | None = None, *, discrepancy: Discrepancy | None = None, progress: Progress | None = None,
        checkpoint: Checkpoint | None = None, resume: dict[str, Any] | None = None,
        earlier: Calibration | Earlier | None = None,
    ) -> Calibration:  # fmt: skip
        """Finds the parameters with which the simulator replays the recordings.

        `earlier`: a calibration of the same simulator with some of these recordings, to go on from (see `recalibrate`).
        Raises what `calibrate` raises.
        """
        chosen, measure = options or Options(), discrepancy
        before = Earlier.of(earlier) if isinstance(earlier, Calibration) else earlier
        acts = resume is None and self._leaves_out(chosen.undisturbed) is not None
        acted = pushed(self.family, self.simulator, (*self.recordings, *self.hold_out)) if acts else None

        def fit(
            simulator: Simulator, recordings: Sequence[Recording], hold_out: Sequence[Recording] = (), *,
            discrepancy: Discrepancy | None = None, cross_validate: bool = True, again: bool = False,
            without: Collection[str] = (), start: Array | None = None,
        ) -> Calibration:  # fmt: skip
            stages = tuple(s for s in chosen.stages or searched_by(chosen.search) if s.name not in without)
            asked = replace(chosen, cross_validate=chosen.cross_validate and cross_validate, stages=stages,
                            undisturbed=self._leaves_out(chosen.undisturbed))  # fmt: skip
            how: dict[str, Any] = {
                "discrepancy": discrepancy or measure, "progress": progress,
                "checkpoint": None if again else checkpoint, "resume": None if again else resume, "left_out": acted,
            }  # fmt: skip
            if before is None or how["resume"] is not None:
                return calibrate(simulator, recordings, hold_out, options=asked, start=start, **how)
            return recalibrate(simulator, recordings, hold_out, before, asked, **how)

        return self._as_recorded(self.family.calibrate(self.simulator, self.recordings, self.hold_out, fit))

    def calibrate_whole(
        self, *, ends: Sequence[End] = (), choose: bool = True, seed: int = 0, progress: Progress | None = None
    ) -> Calibration:  # fmt: skip
        """The same on runs of a free base that fall and touch (see `calibrate_whole`). Raises what that raises."""
        return self._as_recorded(
            calibrate_whole(self.simulator, self.recordings, self.hold_out, ends=ends, choose=choose, seed=seed,
                            progress=progress)
        )  # fmt: skip

    def _leaves_out(self, asked: bool | None) -> bool | None:
        """What `Options.undisturbed` is, unless it is `asked`: as the family diagnoses it."""
        told = NAME not in self.refuse if NAME in self.family.diagnoses else None
        return told if asked is None else asked

    def _as_recorded(self, done: Calibration) -> Calibration:
        """With replays as the recordings were, and none of a model before that had to be guessed."""
        shown = self.family.as_recorded(done.replays, (*self.recordings, *self.hold_out))
        if self.family.known_before(self.simulator):
            return replace(done, replays=shown)
        crossed = tuple(replace(c, rmse_before=nan) for c in done.cross_validation)
        unknown = tuple(replace(r, before=np.full_like(r.before, nan)) for r in shown)
        return replace(done, replays=unknown, cross_validation=crossed)

    def worthwhile(
        self, channels: Sequence[str] | None = None, discrepancy: Discrepancy | None = None, *, seed: int = 0
    ) -> tuple[Preparation, Choice]:
        """The same with only those parameters free that are worth calibrating for replays of these recordings, and why.

        See `worth_calibrating`, whose outcome are the recordings' own motions here. Raises CalibrationError.
        """
        seen = tuple(dict.fromkeys(c for r in self.recordings for c in self.simulator.observable(r)))
        compared = tuple(channels or usual(seen))
        measure = discrepancy or Weighted.estimated(self.recordings, compared)
        choice = worth_calibrating([Problem(self.simulator, self.recordings, measure, compared)],
                                   self.simulator.parameters, rng=np.random.default_rng(seed))  # fmt: skip
        return self._searching(choice.of(self.simulator.parameters)), choice

    def only(self, patterns: Sequence[str]) -> Preparation:
        """The same with only those parameters free that match a pattern. Raises UnknownNameError where one matches none."""
        return self._searching(Restricted.to(self.simulator, patterns).parameters)

    def _searching(self, space: ParameterSpace) -> Preparation:
        if isinstance(self.simulator, Respaced):
            return replace(self, simulator=self.simulator.with_parameters(space))
        return replace(self, simulator=Restricted(self.simulator, space))

    def for_whole_runs(self) -> Preparation:
        """The same with what whole runs of a robot with a free base tell, in place of what longer recordings would."""
        return replace(self, simulator=self.family.for_whole_runs(self.simulator))

    def check(self, channels: Sequence[str] | None = None) -> None:
        """Raises CalibrationError where no recording is left to fit, UnknownNameError for a channel that none of them has."""
        if not self.recordings:
            raise CalibrationError("no recording to fit: all were held out")
        there = {c for r in self.recordings for c in (*r.channels, *self.simulator.observable(r)) if not is_command(c)}
        for name in channels or ():
            if name not in there:
                raise unknown_name("channel", name, sorted(there), "the recordings that are fitted")

    def write(self, calibration: Calibration, model: str | Path, parameters: str | Path) -> tuple[str, ...]:
        """Writes the calibrated model and, where that cannot hold them all, its parameters; notes on what is lost.

        Raises OutputError and ModelError; older files are untouched then.
        """
        if tuple(e.name for e in calibration.estimates) != tuple(self.simulator.parameters.names):
            raise ModelError(f"the calibration is of other parameters than '{self.simulator.name}' has")
        return self.family.write(self.simulator, calibration, Path(model), Path(parameters))

    def usage(self, calibration: Calibration, model: str | Path) -> tuple[str, ...]:
        """Lines of code that simulate the file written by `write` as it was fitted; () where it needs none."""
        return self.family.usage(self.simulator, calibration, Path(model))

    def compare(
        self, against: str | Path | None = None, *, channels: Sequence[str] | None = None, step: float | None = None
    ) -> Comparison:
        """The simulator with its nominal values on all recordings, beside the model file `against` as it is.

        Without one, beside the model as it came. `step` in s is that of `against`. Raises ModelError for a file of
        another family, and SimulationFailedError where the simulator fails on all of them.
        """
        every = (*self.recordings, *self.hold_out)
        other = None if against is None else self._other(Path(against), every, step)
        predictions, notes = self.family.predictions(self.simulator, other, every)
        every = self.family.judged(self.simulator, every)
        seen = sorted({c for r in every for c in self.simulator.observable(r)})

        def replayed(
            recordings: Sequence[Recording], windows: float | None = inf if predictions else None
        ) -> tuple[Replay, ...]:
            return replays(self.simulator, self.simulator.parameters.nominal, (), recordings,
                           channels=channels or usual(seen), against=other, windows=windows)  # fmt: skip

        failed: dict[int, str] = {}
        try:
            found = replayed(every)
        except SimulationFailedError as error:
            failed = error.failed
            if not failed or len(failed) == len(every):
                raise
            found = replayed([r for k, r in enumerate(every) if k not in failed])
        broken = tuple((every[k], why) for k, why in failed.items())
        every = tuple(r for k, r in enumerate(every) if k not in failed)
        shown = self.family.as_recorded(found, every)
        judged, nominal = tuple(dict.fromkeys(r.channel for r in found)), self.simulator.parameters.nominal
        ahead = () if predictions else predicted_ahead(self.simulator, nominal, every, judged)
        acted = disturbed(deviations_in(found, every), lambda: deviations_in(replayed(every, LONG), every))
        noted = acted.notes if NAME in self.family.diagnoses else ()
        return Comparison(shown, predictions, ahead, (*notes, *noted), broken)

    def _other(self, path: Path, recordings: Sequence[Recording], step: float | None) -> Simulator:
        if not isinstance(self.family, type(family_of(path))):
            raise ModelError(f"{path}: '{self.simulator.name}' is compared with {self.family.describes}")
        simulator, _ = self.family.simulator(self.family.load(path), recordings, (), Request(propose=False, step=step))
        return simulator

    def suited(self, recordings: Sequence[Recording]) -> tuple[Recording, ...]:
        """Other recordings of the same robot, as this model can take them."""
        if self.model is None or not recordings:
            return tuple(recordings)
        return self.family.suited(self.model, recordings, refuse=self.refuse).training

    def with_recordings(self, recordings: Sequence[Recording], hold_out: Sequence[Recording] = ()) -> Preparation:
        """The same simulator with other recordings of the same robot, as this model can take them."""
        if self.model is None:
            return replace(self, recordings=tuple(recordings), hold_out=tuple(hold_out))
        fitted, judged = ([in_si(r) for r in each] for each in (recordings, hold_out))
        suited = self.family.suited(self.model, fitted, judged, self.refuse)
        simulator = self.family.following(self.simulator, (*suited.training, *suited.held_out))
        return replace(self, simulator=simulator, recordings=suited.training, hold_out=suited.held_out)

    def unused(self) -> tuple[str, ...]:
        """A note on measured channels that the model has nothing to compare with; a base may be reckoned from them."""
        measured = {name for r in self.recordings for name in r.channels if not is_command(name)}
        used = (
            name for r in self.recordings
            for name in (*self.simulator.observable(r), *self.family.reads(r), *reckoned_of(r), r.provenance.get(TOLD_BY, ""))
        )  # fmt: skip
        left = ", ".join(sorted(measured.difference(used)))
        return (f"not compared, since it is {self.family.compares}: {left}",) if left else ()


def prepare(
    model: str | Path, recordings: Sequence[Recording], hold_out: Sequence[Recording] = (), *,
    parameters: str | Path | None = None, propose: bool = True, beyond_mjcf: bool = False, step: float | None = None,
    refuse: Collection[str] = (), engine: str = "",
) -> Preparation:  # fmt: skip
    """A model file (MJCF, URDF, a car's TOML file, or one of another family) made ready for recordings, and they for it.

    `recordings` are to be fitted, `hold_out` to judge by. What is calibrated stands in the file `parameters`, or is
    proposed from what moves in `recordings`; `propose=False` takes the model as it is. `beyond_mjcf` proposes friction
    that MJCF has no place for too. `step` in s (None: the family's own). What recordings show to be wrong or missing
    is edited and shown (`Preparation.diagnoses`); `refuse` names those that are to stay as they are. `engine` simulates
    robots of joints and links: 'mujoco' (the default) or 'dart'.
    Raises ModelError, ParameterError, RecordingError, UnknownNameError, and MissingExtraError where an engine is not
    installed.
    """
    family = family_of(model, engine)
    loaded = family.load(Path(model))
    check_refused(refuse, family.diagnoses)
    unwanted = frozenset(refuse)
    suited = family.suited(loaded, [in_si(r) for r in recordings], [in_si(r) for r in hold_out], unwanted)
    every = (*suited.training, *suited.held_out)
    request = Request(None if parameters is None else Path(parameters), propose, beyond_mjcf, step, clock_errors(every),
                      unwanted)  # fmt: skip
    simulator, notes = family.simulator(loaded, suited.training, suited.held_out, request)
    return Preparation(family, simulator, suited.training, suited.held_out, (*suited.notes, *notes), unwanted,
                       loaded)  # fmt: skip


def simulator_for(
    model_path: str | Path, recordings: Sequence[Recording], parameters_file: str | Path | None = None, *,
    replayed: Sequence[Recording] = (), beyond_mjcf: bool = False, step: float | None = None,
) -> tuple[Any, tuple[str, ...]]:  # fmt: skip
    """The simulator alone of what `prepare` makes, for recordings that have the model's names and units; and notes."""
    family = family_of(model_path)
    request = Request(
        None if parameters_file is None else Path(parameters_file), True, beyond_mjcf, step,
        clock_errors((*recordings, *replayed)),
    )  # fmt: skip
    simulator, notes = family.simulator(family.load(Path(model_path)), recordings, replayed, request)
    return simulator, tuple(str(note) for note in notes)
