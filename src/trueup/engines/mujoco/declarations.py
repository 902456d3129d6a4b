# SPDX-License-Identifier: Apache-2.0
"""Turns a few declared lines ("kp of every joint, friction mirrored left and right") into parameters."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.quantities import Kind, Quantity, kind, largest, unit_for
from trueup.errors import ParameterError, unknown_name
from trueup.parameters import Parameter, ParameterSpace

TIES = ("each", "all", "mirror")


@dataclass(frozen=True)
class Declaration:
    """One line of a parameters file: a quantity of some elements, each for itself, all tied, or mirrored in pairs."""

    quantity: str
    of: tuple[str, ...] = ("*",)
    """Names or patterns ('*', 'left_*'); a group written 'a+b' shares one value. For joints' actuators a joint's
    name will do."""
    tie: str = "each"
    nominal: float | None = None
    lower: float | None = None
    upper: float | None = None
    scale: str | None = None
    frozen: bool = False
    name: str | None = None
    """What to call the parameter of a tied group; the names of its members joined by '+' if None."""
    optional: str = ""
    """A structure that is kept only if it lowers the error on left-out recordings ("servo zero")."""


def declare(
    model: Model, declarations: Sequence[Declaration], extra: Mapping[str, Sequence[str]] | None = None
) -> tuple[ParameterSpace, tuple[Quantity, ...]]:
    """The parameter space and what each parameter writes. `extra` lists names of families that are not in the model
    ('channel', 'recording'). Raises UnknownNameError and ParameterError, naming the declaration's quantity.
    """
    parameters: list[Parameter] = []
    quantities: list[Quantity] = []
    for line in declarations:
        if line.tie not in TIES:
            raise ParameterError(f"quantity '{line.quantity}': tie '{line.tie}' is not one of: {', '.join(TIES)}")
        k = kind(line.quantity)
        for group in _groups(model, k, line, extra or {}):
            parameter, quantity = _parameter(model, k, line, group)
            parameters.append(parameter)
            quantities.append(quantity)
    return ParameterSpace(tuple(parameters)), tuple(quantities)


def _groups(model: Model, k: Kind, line: Declaration, extra: Mapping[str, Sequence[str]]) -> list[tuple[str, ...]]:
    if k.family == "world":
        return [("world",)]
    known = _known(model, k, extra)
    if line.tie == "all":
        return [tuple(dict.fromkeys(n for pattern in line.of for n in _matches(pattern, known, k)))]
    if line.tie == "mirror":
        names = list(dict.fromkeys(n for pattern in line.of for n in _matches(pattern, known, k)))
        return _mirrored(names)
    groups: list[tuple[str, ...]] = []
    for pattern in line.of:
        if "+" in pattern:
            groups.append(tuple(n for part in pattern.split("+") for n in _matches(part.strip(), known, k)))
        else:
            groups += [(n,) for n in _matches(pattern, known, k)]
    return list(dict.fromkeys(groups))


def _known(model: Model, k: Kind, extra: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """What a user may write, to the element's name: actuators also answer to the name of their joint."""
    if k.family == "actuator":
        names = model.names("actuator")
        choices = {n: n for n in names if n}
        for joint, i in model.actuator_of_joint().items():
            choices.setdefault(joint, names[i])
        if k.name in ("kp", "kv", "zero", "dead_band", "speed_limit", "acceleration_limit"):
            servos = {n for i, n in enumerate(names) if model.is_position_servo(i)}
            if servos:
                choices = {a: n for a, n in choices.items() if n in servos}
        return choices
    if k.family == "joint":
        return {n: n for n in model.scalar_joints()}
    if k.family in ("body", "geom"):
        return {n: n for n in model.names(k.family) if n and n != "world"}
    if k.name == "clock":
        return {r: r for r in extra.get("recording", ())}
    if k.family == "recording":
        return {f"{r}:{j}": f"{r}:{j}" for r in extra.get("recording", ()) for j in model.scalar_joints()}
    return {n: n for n in extra.get(k.family, ())}


def _matches(pattern: str, known: Mapping[str, str], k: Kind) -> list[str]:
    if pattern in known:
        return [known[pattern]]
    found = [known[n] for n in known if fnmatch.fnmatchcase(n, pattern)]
    if not found:
        raise unknown_name(k.family, pattern, known)
    return list(dict.fromkeys(found))


def _mirrored(names: Sequence[str]) -> list[tuple[str, ...]]:
    """Left and right of the same part share a value; what has no partner stands for itself."""
    groups: dict[str, list[str]] = {}
    for name in names:
        neutral = re.sub(r"(^|[_\-./])(left|right|l|r)(?=$|[_\-./])", r"\1*", name, flags=re.IGNORECASE)
        neutral = re.sub(r"(^|[_\-./])([LR])(?=[A-Z])", r"\1*", neutral)
        neutral = re.sub(r"(?i)(left|right)", "*", neutral)
        groups.setdefault(neutral, []).append(name)
    return [tuple(g) for g in groups.values()]


def _parameter(model: Model, k: Kind, line: Declaration, group: tuple[str, ...]) -> tuple[Parameter, Quantity]:
    values = [k.nominal(model, n) for n in group]
    mirrored_y = line.tie == "mirror" and k.name in ("com_y", "inertia_t2", "inertia_s12", "inertia_s23")
    signs = tuple(1.0 if v * values[0] >= 0 else -1.0 for v in values) if mirrored_y else ()
    nominal = line.nominal if line.nominal is not None else float(values[0])
    usual = k.bounds(nominal)
    lower = line.lower if line.lower is not None else usual[0]
    upper = line.upper if line.upper is not None else max(usual[1], *(largest(k, model, n) for n in group))
    scale = line.scale or k.scale
    if scale == "log" and not line.frozen and line.nominal is None:
        nominal = min(max(nominal, lower), upper)  # a nominal of zero cannot start on a log scale
    label = line.name or _label(group, line)
    parameter = Parameter(
        name=label if label == k.name else f"{label}.{k.name}", unit=unit_for(k, model, group[0]), nominal=nominal,
        lower=lower, upper=upper, scale=scale, frozen=line.frozen, shown_by=k.shown_by,
        source="declared" if line.nominal is not None else "model", optional=line.optional,
    )  # fmt: skip
    return parameter, Quantity(k.name, group, signs)


def _label(group: tuple[str, ...], line: Declaration) -> str:
    if group == ("world",):
        return line.quantity
    if len(group) == 1:
        return group[0]
    if line.tie == "all" and line.of == ("*",):
        return line.quantity
    return "+".join(group)
