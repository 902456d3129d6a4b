# SPDX-License-Identifier: Apache-2.0
"""Parameters files (TOML): reads declarations, and writes what was found so that it can be given back."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from trueup import files
from trueup.articulated.assignments import Assignment
from trueup.articulated.declarations import Declaration
from trueup.articulated.model import WORLD
from trueup.articulated.quantities.known import quantity
from trueup.calibration import Calibration, Estimate
from trueup.errors import ParameterError
from trueup.formats.aside import written_aside
from trueup.parameters import Parameter, ParameterSpace

_DECLARED = ("quantity", "of", "tie", "nominal", "lower", "upper", "scale", "frozen", "name", "optional")
_OF_RESULTS = ("unit", "start", "low", "high", "verdict", "note")
"""Keys that a result adds; they are read over."""

_TITLE = """\
# Parameters of {model}, found by trueup. Give this file back with --parameters to start from here, or to replay.
# nominal is the value that was found, low ... high its 95 % interval; frozen = true keeps a value as it is.
# A line may also hold several: of = "*" or ["left_*", "right_*"]; tie = "each", "all" or "mirror".
"""


def read_declarations(path: str | Path) -> list[Declaration]:
    """The declarations in a parameters file: tables [[parameter]] with quantity, of, tie, nominal, lower, upper, ...

    Raises ParameterError, naming file, table and key, for what is unknown, missing or of the wrong kind.
    """
    data = _read(path)
    unknown = sorted(set(data) - {"parameter", "gains"})
    if unknown:
        raise ParameterError(f"{path}: unknown table '{unknown[0]}'; parameters are tables [[parameter]]")
    tables = data.get("parameter")
    if not isinstance(tables, list) or not tables:
        raise ParameterError(f'{path}: no [[parameter]] is declared; add one with quantity = "friction", of = "*"')
    base = Path(path).parent
    return [_declaration(table, f"{path}, [[parameter]] {i}", base) for i, table in enumerate(tables, 1)]


def read_gains(path: str | Path | None) -> dict[str, float]:
    """For which settings of the servos the values of a parameters file hold ([gains], see `Gains`); {} for no file.

    Raises ParameterError, naming file and key.
    """
    table = _read(path).get("gains", {}) if path is not None else {}
    if not isinstance(table, Mapping):
        raise ParameterError(f"{path}: [gains] is not a table of numbers")
    found = {key: _number(table, key, f"{path}, [gains]") for key in table}
    return {key: value for key, value in found.items() if value is not None}


def _read(path: str | Path) -> dict[str, Any]:
    return files.toml(Path(path), ParameterError)


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
        lines += ["[gains] # of the servos, as recordings name them", *(f"{k} = {v!r}" for k, v in gains.items()), ""]
    for estimate, parameter, assignment in zip(calibration.estimates, space.parameters, assignments, strict=True):
        lines += ["[[parameter]]", *_table(estimate, parameter, assignment), ""]
    with written_aside(Path(path)) as temporary:
        temporary.write_text("\n".join(lines), encoding="utf-8")


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
    rows |= {"nominal": estimate.value, "unit": estimate.unit, "start": estimate.start}
    if math.isfinite(estimate.low) and math.isfinite(estimate.high):
        rows |= {"low": estimate.low, "high": estimate.high}
    rows |= {"lower": parameter.lower, "upper": parameter.upper, "scale": parameter.scale, "verdict": estimate.verdict}
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
    if not isinstance(table, Mapping):
        raise ParameterError(f"{where}: {table!r} is not a table of keys")
    for key in table:
        if key not in (*_DECLARED, *_OF_RESULTS):
            raise ParameterError(f"{where}: unknown key '{key}'; keys are: {', '.join((*_DECLARED, *_OF_RESULTS))}")
    if "quantity" not in table:
        raise ParameterError(f"{where}: 'quantity' is missing; for example quantity = \"friction\"")
    known = quantity(_text(table, "quantity", where), base)
    unit = table.get("unit", known.unit)
    if unit not in known.units():
        raise ParameterError(
            f"{where}: unit '{unit}' is given, but {known.name} is in '{known.unit}'; convert the numbers"
        )
    return Declaration(
        quantity=known if known.origin else known.name,
        of=_texts(table.get("of", "*"), where),
        tie=_text(table, "tie", where, "each"),
        nominal=_number(table, "nominal", where),
        lower=_number(table, "lower", where),
        upper=_number(table, "upper", where),
        scale=_text(table, "scale", where) if "scale" in table else None,
        frozen=_truth(table, "frozen", where),
        name=_text(table, "name", where) if "name" in table else None,
        optional=_text(table, "optional", where, ""),
    )


def _text(table: Mapping[str, Any], key: str, where: str, default: str = "") -> str:
    value = table.get(key, default)
    if not isinstance(value, str):
        raise ParameterError(f"{where}: {key} = {value!r} is not a text in quotes")
    return value


def _texts(value: Any, where: str) -> tuple[str, ...]:
    entries = [value] if isinstance(value, str) else value
    if not isinstance(entries, list) or not entries or not all(isinstance(e, str) for e in entries):
        raise ParameterError(f"{where}: of = {value!r} is neither a name nor a list of names")
    return tuple(entries)


def _number(table: Mapping[str, Any], key: str, where: str) -> float | None:
    value = table.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ParameterError(f"{where}: {key} = {value!r} is not a finite number")
    return float(value)


def _truth(table: Mapping[str, Any], key: str, where: str) -> bool:
    value = table.get(key, False)
    if not isinstance(value, bool):
        raise ParameterError(f"{where}: {key} = {value!r} is neither true nor false")
    return value
