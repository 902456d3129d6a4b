# SPDX-License-Identifier: Apache-2.0
"""Parameters files (TOML): reads declarations, and writes what was found so that it can be given back."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from trueup import files
from trueup.articulated.assignments import Assignment
from trueup.articulated.declarations import Declaration
from trueup.articulated.model import WORLD
from trueup.articulated.quantities.known import quantity
from trueup.calibration import Calibration, Estimate
from trueup.errors import ParameterError
from trueup.formats.aside import write_aside
from trueup.parameters import Parameter, ParameterSpace
from trueup.rounding import ROUNDED
from trueup.typed_toml import build


@dataclass(frozen=True)
class _Entry:
    """A table [[parameter]]: a Declaration, and behind `unit` what a result adds, which is read over."""

    quantity: str
    of: str | tuple[str, ...] = "*"
    tie: str = "each"
    nominal: float | None = None
    lower: float | None = None
    upper: float | None = None
    scale: str | None = None
    frozen: bool = False
    name: str | None = None
    optional: str = ""
    unit: str | None = None
    start: Any = None
    low: Any = None
    high: Any = None
    verdict: Any = None
    note: Any = None

    def __post_init__(self) -> None:
        """Raises ValueError for what is of the right kind and means nothing."""
        if not self.of:
            raise ValueError("of = [] names nothing")
        _finite({name: getattr(self, name) for name in ("nominal", "lower", "upper")})


@dataclass(frozen=True)
class _ParametersFile:
    parameter: tuple[Mapping[str, Any], ...] = ()
    gains: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _finite(self.gains)


def _finite(numbers: Mapping[str, float | None]) -> None:
    for name, value in numbers.items():
        if value is not None and not math.isfinite(value):
            raise ValueError(f"{name} = {value!r} is not a finite number")


_TITLE = """\
# Parameters of {model}, found by trueup. Give this file back with --parameters to start from here, or to replay.
# nominal is the value that was found, low ... high its 95 % interval; frozen = true keeps a value as it is.
# A line may also hold several: of = "*" or ["left_*", "right_*"]; tie = "each", "all" or "mirror".
"""


def read_declarations(path: str | Path) -> list[Declaration]:
    """The declarations in a parameters file: tables [[parameter]] with quantity, of, tie, nominal, lower, upper, ...

    Raises ParameterError, naming file, table and key, for what is unknown, missing or of the wrong kind.
    """
    tables = _read(path).parameter
    if not tables:
        raise ParameterError(f'{path}: no [[parameter]] is declared; add one with quantity = "friction", of = "*"')
    base = Path(path).parent
    return [_declaration(table, f"{path}, [[parameter]] {i}", base) for i, table in enumerate(tables, 1)]


def read_gains(path: str | Path | None) -> dict[str, float]:
    """For which settings of the servos the values of a parameters file hold ([gains], see `Gains`); {} for no file.

    Raises ParameterError, naming file and key.
    """
    return dict(_read(path).gains) if path is not None else {}


def _read(path: str | Path) -> _ParametersFile:
    return build(_ParametersFile, files.toml(Path(path), ParameterError), str(path), ParameterError)


def write_parameters(
    calibration: Calibration, space: ParameterSpace, assignments: Sequence[Assignment], path: str | Path,
    gains: Mapping[str, float] | None = None,
) -> None:  # fmt: skip
    """Writes every parameter with its value, interval, verdict and bounds, such that `read_declarations` reads it.

    `space` and `assignments` are those of the simulator that was calibrated, in the order of the estimates; `gains` the
    settings of the servos for which they hold. Written
    aside and renamed; raises OutputError, and what was there before is untouched.
    """
    lines = [_TITLE.format(model=calibration.model_name)]
    if gains:
        held = [f"{_key(name)} = {value!r}" for name, value in gains.items()]
        lines += ["[gains] # of the servos, as recordings name them", *held, ""]
    for estimate, parameter, assignment in zip(calibration.estimates, space.parameters, assignments, strict=True):
        lines += ["[[parameter]]", *_table(estimate, parameter, assignment), ""]
    write_aside("\n".join(lines), Path(path))


def _key(name: str) -> str:
    return name if name.isidentifier() else json.dumps(name)


def _inside(value: float, parameter: Parameter) -> float:
    """A value that lies beyond a bound by rounding alone, as exp(log(bound)) does, at it: the file would be refused."""
    within = min(max(value, parameter.lower), parameter.upper)
    return within if abs(value - within) <= ROUNDED * abs(within) else value


def _table(estimate: Estimate, parameter: Parameter, assignment: Assignment) -> list[str]:
    label = estimate.name.removesuffix(f".{assignment.kind}")
    targets = ["*"] if WORLD in assignment.targets else list(assignment.targets)
    tie = "mirror" if assignment.signs else "all" if len(targets) > 1 else ""
    name = assignment.quantity.origin or assignment.kind
    rows: dict[str, Any] = {"quantity": name, "of": targets if len(targets) > 1 else targets[0]}
    if tie:
        rows["tie"] = tie
    if label != targets[0]:
        rows["name"] = label
    rows |= {"nominal": _inside(estimate.value, parameter), "unit": estimate.unit, "start": estimate.start}
    if math.isfinite(estimate.low) and math.isfinite(estimate.high):
        rows |= {"low": estimate.low, "high": estimate.high}
    rows |= {"lower": parameter.lower, "upper": parameter.upper, "scale": parameter.scale}
    if estimate.verdict:
        rows["verdict"] = estimate.verdict
    if estimate.note:
        rows["note"] = estimate.note
    if not estimate.fitted:
        rows["frozen"] = True
    if parameter.optional and not (estimate.fitted and parameter.absent is not None):  # kept: it is asked about no more
        rows["optional"] = parameter.optional
    return [f"{key} = {_toml(value)}" for key, value in rows.items()]


def _toml(value: Any) -> str:
    if isinstance(value, float):
        return repr(float(value))
    # JSON's texts, lists and truth values are TOML's, except that TOML wants DEL escaped.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _declaration(table: Any, where: str, base: Path) -> Declaration:
    entry = build(_Entry, table, where, ParameterError)
    known = quantity(entry.quantity, base)
    if entry.unit is not None and entry.unit not in known.units():
        raise ParameterError(
            f"{where}: unit '{entry.unit}' is given, but {known.name} is in '{known.unit}'; convert the numbers"
        )
    return Declaration(
        known if known.origin else known.name, (entry.of,) if isinstance(entry.of, str) else entry.of, entry.tie,
        entry.nominal, entry.lower, entry.upper, entry.scale, entry.frozen, entry.name, entry.optional,
    )  # fmt: skip
