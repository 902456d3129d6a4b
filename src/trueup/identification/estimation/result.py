# SPDX-License-Identifier: Apache-2.0
"""What an identification found: everything that reports and files are made from."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from trueup.arrays import Array
from trueup.rounding import TINY
from trueup.samples import rms

if TYPE_CHECKING:
    from trueup.identification.estimation.file_fit import FileFit
    from trueup.identification.torque_model import TorqueModel


@dataclass(frozen=True, eq=False)
class Prediction:
    """One recording's torque, measured and predicted; arrays are (S, n) in N m (N), rad and rad/s (m, m/s)."""

    recording: str
    held_out: bool
    time: Array
    """(S,) in s."""
    measured: Array
    fitted: Array
    """By the unconstrained model."""
    consistent: Array | None
    """By the physically consistent one."""
    file: Array | None
    """By the model file as it was given; None where it has no inertias."""
    position: Array
    velocity: Array
    reach: Array
    """(S, 3) where the last link's frame is, in m in the base frame."""
    by: Callable[[Callable[[Array, Array, Array], Array]], Array] | None = None
    """(S, n) what any other function of positions, speeds and accelerations (T, n) says of this motion."""


@dataclass(frozen=True)
class Parameter:
    """One combination that torque can tell."""

    name: str
    """Readable: 'I2zz + I2m + 0.49 m3'."""
    unit: str
    kind: str
    """'inertial' or the name of an effect ('viscous', 'rotor', ...)."""
    joint: str
    value: float
    deviation: float
    """Standard deviation, with the errors' memory."""
    file: float
    """What the model file says; NaN where it says nothing."""
    consistent: float
    """In the model file that is written; NaN where it has no place for it."""
    verdict: str
    """'identified', 'roughly', 'small', 'shared' or 'not seen'."""
    note: str = ""
    """What an effect is, in words."""

    @property
    def relative(self) -> float:
        """Standard deviation over size."""
        return self.deviation / abs(self.value) if self.value else math.inf


@dataclass(frozen=True)
class Link:
    """One link's ten inertial parameters as they are written to a model file, and what to mind."""

    name: str
    mass: float
    com: tuple[float, float, float]
    """m, in the link's frame."""
    moments: tuple[float, float, float]
    """Principal moments of inertia about the centre of mass in kg m^2, largest last."""
    on_boundary: bool
    """Whether the fit wanted a mass distribution that no body has, and stopped at the edge of what is possible."""
    violation: str = ""
    """What would be impossible in the unconstrained fit, in words."""


@dataclass(frozen=True)
class Alignment:
    """Torque against position in time."""

    shift: float
    """s by which torque comes late (negative: early)."""
    deviation: float
    rate: float
    """Samples per second of the log."""
    corrected: bool
    gain: float
    """How much smaller the squared error is with the shift taken out, as a share."""

    @property
    def samples(self) -> float:
        """The shift in samples of the log."""
        return self.shift * self.rate


@dataclass(frozen=True, eq=False)
class Identification:
    """A dynamic model of an arm and how well it predicts torque. Arrays are (n,), in the order of `joints`."""

    model_name: str
    joints: tuple[str, ...]
    prismatic: tuple[bool, ...]
    units: tuple[str, ...]
    """Of each joint's torque: N m, N for a slide, or that of the log where it holds currents of unknown constants."""
    effort: Array
    """Torque limits of the model file, N m (N); NaN where it has none."""
    parameters: tuple[Parameter, ...]
    links: tuple[Link, ...]
    predictions: tuple[Prediction, ...]
    noise: Array
    """Standard deviation of the error on the training data."""
    cross_validation: Array
    """(K, n) root mean squared errors of blocks, each predicted by a fit to the others."""
    alignment: Alignment | None
    structure: tuple[tuple[str, ...], ...]
    """For each joint the effects that were kept, in words."""
    model: TorqueModel
    """All that was identified: predicts torque for any motion."""
    for_file: FileFit | None
    """Bodies that can exist, rotors, Coulomb and viscous friction, fitted together: what a URDF or MJCF can hold."""
    cutoff: float
    """Hz."""
    rate: float
    """Samples per second that were compared."""
    weighting: str
    trust: float
    """Strength of the pull of the fit towards the model file; about 1e-9 is none."""
    pull: float
    """The same for the consistent model, which takes from the file what torque cannot tell."""
    advice: tuple[str, ...]
    """What these recordings could not tell, and which motion would."""
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    seconds: float

    @property
    def unit(self) -> str:
        """The unit of all torques, or the units."""
        return ", ".join(dict.fromkeys(self.units))

    def held_out(self) -> list[Prediction]:
        """The recordings, or parts of them, that were not fitted."""
        return [p for p in self.predictions if p.held_out]

    def training(self) -> list[Prediction]:
        """Those that were."""
        return [p for p in self.predictions if not p.held_out]

    def judged(self) -> list[Prediction]:
        """Held out if there is any, else training: say which."""
        return self.held_out() or self.training()

    def error_density(self) -> Array:
        """(n,) what `trueup excite --after` expects again: power density of the fit's errors at low frequencies."""
        from trueup.identification.estimation.estimate import lasting_density

        return lasting_density([p.measured - p.fitted for p in self.training()], self.rate)

    def cross_validated(self) -> float:
        """Root mean squared error over all joints and blocks."""
        return float(rms(self.cross_validation, axis=None)) if self.cross_validation.size else math.nan


def relative_error(predictions: Sequence[Prediction], which: str = "fitted") -> float:
    """||measured - predicted|| / ||measured|| over all joints and samples; NaN where there is no such prediction."""
    errors, size = 0.0, 0.0
    for p in predictions:
        predicted = getattr(p, which)
        if predicted is None:
            return math.nan
        errors += float(np.sum((p.measured - predicted) ** 2))
        size += float(np.sum(p.measured**2))
    return math.sqrt(errors / size) if size else math.nan


def rmse(predictions: Sequence[Prediction], which: str = "fitted") -> Array:
    """(n,) root mean squared error of each joint, N m (N)."""
    errors = np.concatenate([p.measured - getattr(p, which) for p in predictions])
    return rms(errors)


def relative_errors(predictions: Sequence[Prediction], which: str = "fitted") -> Array:
    """(n,) the relative error of each joint."""
    size = rms(np.concatenate([p.measured for p in predictions]))
    return rmse(predictions, which) / np.maximum(size, TINY)


@dataclass(frozen=True, eq=False)
class LogError:
    """How far a model's torque is from that of one log; arrays are (n,)."""

    recording: str
    held_out: bool
    count: int
    squares: Array
    """Sums of squared errors, (N m)^2."""
    power: Array
    """Sums of squared torques that were measured."""


@dataclass(frozen=True, eq=False)
class Deliverable:
    """One thing that is handed over, and how good it is as it was read back from its file."""

    name: str
    """'fit', 'predictor', 'C header', 'Python file', 'model file' or 'model file as given'."""
    files: tuple[str, ...]
    """In the folder; none for what is no file."""
    use: str
    """What it is for."""
    errors: tuple[LogError, ...] = ()
    difference: float = math.nan
    """Largest difference of its torque from the fit's, N m (N)."""
    seconds: float = math.nan
    """A call, for one instant."""
    note: str = ""

    def relative(self, *, held_out: bool) -> float:
        """||measured - predicted|| / ||measured|| over all joints and samples of one kind; NaN without any."""
        chosen = [e for e in self.errors if e.held_out == held_out]
        power = sum(float(e.power.sum()) for e in chosen)
        return math.sqrt(sum(float(e.squares.sum()) for e in chosen) / power) if power else math.nan

    def relative_by_joint(self, *, held_out: bool) -> Array:
        """(n,) the same of each joint."""
        chosen = [e for e in self.errors if e.held_out == held_out]
        power = np.sum([e.power for e in chosen], axis=0)
        return np.sqrt(np.sum([e.squares for e in chosen], axis=0) / np.maximum(power, TINY))


def log_errors(predictions: Sequence[Prediction], predicted: Sequence[Array]) -> tuple[LogError, ...]:
    """The errors of what is `predicted` (S, n) for each log."""
    return tuple(
        LogError(
            p.recording, p.held_out, len(p.time), np.sum((p.measured - x) ** 2, axis=0), np.sum(p.measured**2, axis=0)
        )
        for p, x in zip(predictions, predicted, strict=True)
    )
