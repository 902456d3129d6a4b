# SPDX-License-Identifier: Apache-2.0
"""Arms, hands and legs simulated by DART: the same files, recordings and declarations, another engine's contacts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from trueup.articulated.declarations import Declaration, declare
from trueup.articulated.gains import Gains
from trueup.articulated.quantities.known import quantity
from trueup.articulated.quantities.quantity import Quantity
from trueup.articulated.simulator import ArticulatedSimulator
from trueup.calibration import Calibration
from trueup.engines.dart.model import OFFERED, DartModel, of
from trueup.engines.family import Note
from trueup.engines.mujoco.family import Articulated
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.errors import ModelError
from trueup.recording import Recording


class DartRobots(Articulated):
    """Robots of joints and links in DART. Their models are read, changed and written as MuJoCo's are."""

    def load(self, path: Path) -> Model:
        """The model in a file. Raises ModelError, and MissingExtraError where dartpy is not installed."""
        return of(super().load(path)).file

    def engine_simulator(
        self, model: Model, lines: Sequence[Declaration], names: Mapping[str, Sequence[str]], gains: Gains, step: float,
        *, declared: bool,
    ) -> tuple[ArticulatedSimulator, tuple[Note, ...]]:  # fmt: skip
        """Without what is only proposed and DART has not. Raises ModelError where it was declared."""
        lacking = {k.name: line for line in lines for k in (_kind(line),) if not set(k.attributes) <= set(OFFERED)}
        if lacking and declared:
            raise ModelError(
                f"DART has no {', '.join(lacking)}: leave these lines out of the parameters file, or calibrate in MuJoCo "
                "(--engine mujoco)"
            )
        engine = of(model)
        kept = [line for line in lines if line not in lacking.values()]
        notes = (f"not calibrated, since DART has no such thing: {', '.join(lacking)}",) if lacking else ()
        return ArticulatedSimulator(engine, *declare(engine, kept, names), step=step, gains=gains), notes

    def write(
        self, simulator: Any, calibration: Calibration, model: Path, parameters: Path
    ) -> tuple[str, ...]:  # fmt: skip
        """As MuJoCo's family does; the values are those of another engine."""
        notes = super().write(_twin(simulator), calibration, model, parameters)
        return (*notes, "the values were found in DART: MuJoCo's contacts and joint limits answer a little differently")

    def file_of(self, simulator: Any) -> Model:
        """See Articulated."""
        return _engine(simulator).file

    def known_before(self, simulator: Any) -> bool:
        """See Family."""
        return not _engine(simulator).file.guessed

    def usage(self, simulator: Any, calibration: Calibration, model: Path) -> tuple[str, ...]:
        """See Family: DART steps the written file."""
        return (
            "from trueup.engines import dart",
            f'simulator = dart.simulator(dart.load("{model.as_posix()}"), step={simulator.step:g})',
        )

    def following(self, simulator: Any, recordings: Sequence[Recording]) -> Any:
        """See Family."""
        if not isinstance(simulator, ArticulatedSimulator):
            return simulator
        return replace(simulator, gains=Gains.named_by(recordings, simulator.gains.given_for)[0])

    def advice(self, simulator: Any, calibration: Calibration | None = None) -> tuple[str, ...]:
        """See Family."""
        return super().advice(_twin(simulator), calibration)


def _kind(line: Declaration) -> Quantity:
    return line.quantity if isinstance(line.quantity, Quantity) else quantity(line.quantity)


def _engine(simulator: ArticulatedSimulator) -> DartModel:
    if not isinstance(simulator.engine, DartModel):
        raise ModelError(f"'{simulator.name}' is no model of DART")
    return simulator.engine


def _twin(simulator: ArticulatedSimulator) -> MujocoSimulator:
    """The same model and parameters as MuJoCo has them."""
    return MujocoSimulator(
        _engine(simulator).file, simulator.parameters, simulator.quantities, step=simulator.step, gains=simulator.gains
    )
