# SPDX-License-Identifier: Apache-2.0
"""Turns a few declared lines ("kp of every joint, friction mirrored left and right") into parameters."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from trueup.articulated.assignments import Assignment
from trueup.articulated.model import WORLD, Model, servos
from trueup.articulated.quantities.known import quantity
from trueup.articulated.quantities.quantity import Quantity
from trueup.errors import ParameterError, unknown_name
from trueup.parameters import Parameter, ParameterSpace

TIES = ("each", "all", "mirror")
SOFTNESS = "contact_softness"


@dataclass(frozen=True)
class Declaration:
    """One line of a parameters file: a quantity of some elements, each for itself, all tied, or mirrored in pairs."""

    quantity: str | Quantity
    """A name (see `known.quantities`), 'module:attribute', or a Quantity of your own."""
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
) -> tuple[ParameterSpace, tuple[Assignment, ...]]:
    """The parameter space and what each parameter sets. `extra` lists names of families that are not in the model
    ('channel', 'recording'). Raises UnknownNameError and ParameterError, naming the declaration's quantity.
    """
    parameters: list[Parameter] = []
    assignments: list[Assignment] = []
    for line in declarations:
        q = line.quantity if isinstance(line.quantity, Quantity) else quantity(line.quantity)
        if line.tie not in TIES:
            raise ParameterError(f"quantity '{q.name}': tie '{line.tie}' is not one of: {', '.join(TIES)}")
        where = f"the shapes of '{model.name}' that can touch" if q.needs == "shapes" else "the model"
        for group in _groups(line, q, q.choices(model, extra or {}), where):
            parameter, assignment = _parameter(model, q, line, group)
            parameters.append(parameter)
            assignments.append(assignment)
    return ParameterSpace(tuple(parameters)), tuple(assignments)


RELATED = ("kv", "damping", "armature")
"""Quantities that may do to a joint what another one does: forces by its speed, and by its acceleration."""


LACKING = {
    "play and twist of gears": ("gear_backlash", "gear_compliance"),
    "backlash": ("backlash",),
    "a dead band of the servos": ("dead_band",),
    "friction that grows with the load": ("friction_load",),
    "friction that is larger at rest": ("friction_static",),
    "springs at the joints": ("spring", "spring_rest"),
    "springs that stiffen": ("spring_cubic",),
    "links of another mass or balance": ("mass", "com_x", "com_y", "com_z"),
}
"""What robots have and their models often lack, each the quantities that make it."""
_REFINED = ("springs that stiffen",)
"""Of these what refines another one, which stands for it among what recordings leave open."""


def lacking(model: Model, assignments: Sequence[Assignment]) -> dict[str, tuple[Declaration, ...]]:
    """Lines for each of LACKING of which nothing is declared, at the joints whose rotor or friction is calibrated and at all
    bodies that have a mass. They begin as the model has them, or with none where a search would begin with some.
    """
    there = {a.quantity.group or a.kind for a in assignments}
    joints = tuple(dict.fromkeys(t for a in assignments if a.kind in ("friction", "armature") for t in a.targets))
    drives, stiff = model.drives(), servos(model)
    moved = tuple(dict.fromkeys(drives[j] for j in joints if drives.get(j) in stiff))
    heavy = tuple(b for b in quantity("mass").choices(model, {}) if model.get("body.mass", b)[0] > 0.0)
    targets = {"joint": joints, "actuator": moved, "body": () if "inertia" in there else heavy}
    return {
        name: tuple(Declaration(q, targets[q.family], nominal=0.0 if q.start else None) for q in map(quantity, kinds))
        for name, kinds in LACKING.items()
        if joints and not there & set(kinds) and targets[quantity(kinds[0]).family]
    }


def of_contacts(model: Model) -> tuple[Declaration, ...]:
    """How soft contacts are: named shapes that begin alike stay so, as only what comes of two that touch is seen. None for
    shapes whose file says something else in place of a time constant, as MuJoCo has it below zero.
    """
    soft, groups = quantity(SOFTNESS), dict[float, list[str]]()
    for shape in soft.choices(model, {}):
        groups.setdefault(soft.nominal(model, shape), []).append(shape)
    several = len(groups) > 1
    return tuple(
        Declaration(soft.name, tuple(shapes) if several else ("*",), tie="all")
        for size, shapes in groups.items()
        if size > 0.0
    )


def alike(model: Model, structures: Mapping[str, tuple[Declaration, ...]]) -> list[dict[str, tuple[Declaration, ...]]]:
    """Those of some structures that cannot be less than none, in groups for which a model is prepared alike; without what
    only refines another one.
    """
    groups: dict[str, dict[str, tuple[Declaration, ...]]] = {}
    for name, lines in structures.items():
        if name in _REFINED:
            continue
        space, assignments = declare(model, lines)
        if any(p.nominal <= p.lower for p in space.parameters):
            kinds = {a.quantity.needs for a in assignments}
            groups.setdefault(" ".join(sorted(kinds)), {})[name] = lines
    return list(groups.values())


def undeclared(
    model: Model, assignments: Sequence[Assignment], following: Sequence[str] = ()
) -> tuple[Declaration, ...]:
    """A line for each of RELATED at each joint and drive for which no parameter is declared, as far as the model has it:
    what is zero there is no number that could be wrong. So is friction of the joints `following` others by a constraint.
    """
    there = {(a.kind, target) for a in assignments for target in a.targets}
    lines = []
    for name in RELATED:
        q = quantity(name)
        targets = dict.fromkeys(q.choices(model, {}).values()) if servos(model) or not q.servos_only else {}
        lines.append(
            Declaration(name, tuple(t for t in targets if (name, t) not in there and q.nominal(model, t) > 0.0))
        )
    held = (j for j in following if ("friction", j) not in there and quantity("friction").nominal(model, j) > 0.0)
    lines.append(Declaration("friction", tuple(held)))
    return tuple(line for line in lines if line.of)


def _groups(line: Declaration, q: Quantity, known: Mapping[str, str], where: str) -> list[tuple[str, ...]]:
    if q.family == WORLD:
        return [(WORLD,)]
    if line.tie == "all":
        return [tuple(dict.fromkeys(n for pattern in line.of for n in _matches(pattern, known, q, where)))]
    if line.tie == "mirror":
        names = list(dict.fromkeys(n for pattern in line.of for n in _matches(pattern, known, q, where)))
        return _mirrored(names)
    groups: list[tuple[str, ...]] = []
    for pattern in line.of:
        if "+" in pattern:
            groups.append(tuple(n for part in pattern.split("+") for n in _matches(part.strip(), known, q, where)))
        else:
            groups += [(n,) for n in _matches(pattern, known, q, where)]
    return list(dict.fromkeys(groups))


def _matches(pattern: str, known: Mapping[str, str], q: Quantity, where: str) -> list[str]:
    if pattern in known:
        return [known[pattern]]
    found = [known[n] for n in known if fnmatch.fnmatchcase(n, pattern)]
    if not found:
        raise unknown_name(q.family, pattern, known, where)
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


def _parameter(model: Model, q: Quantity, line: Declaration, group: tuple[str, ...]) -> tuple[Parameter, Assignment]:
    values = [q.nominal(model, n) for n in group]
    mirrored = line.tie == "mirror" and q.mirrored
    # Where a value is zero on both sides, only the sides' mirror can tell which way it grows.
    signs = tuple(1.0 if i == 0 or v * values[0] > 0 else -1.0 for i, v in enumerate(values)) if mirrored else ()
    nominal = line.nominal if line.nominal is not None else float(values[0])
    lower = line.lower if line.lower is not None else min(q.least(model, n, nominal) for n in group)
    reach = [q.reach(model, n) for n in group] if q.reach is not None else []
    upper = line.upper if line.upper is not None else max([q.bounds(nominal)[1], *reach])
    scale = line.scale or q.scale
    if scale == "log" and not line.frozen and line.nominal is None:
        nominal = min(max(nominal, lower, min(q.begun(model, n, nominal) for n in group)), upper)
    label, unsigned = line.name or _label(group, line, q), q.bounds(0.0)[0] >= 0.0
    parameter = Parameter(
        name=label if label == q.name else f"{label}.{q.name}", unit=q.unit_at(model, group[0]), nominal=nominal,
        lower=lower, upper=upper, scale=scale, frozen=line.frozen, shown_by=q.shown_by,
        source="declared" if line.nominal is not None else "model", optional=line.optional,
        absent=q.nothing, vanishes=unsigned and (lower == 0.0 or (line.nominal is line.lower is None and not values[0])),
    )  # fmt: skip
    return parameter, Assignment(q, group, signs)


def _label(group: tuple[str, ...], line: Declaration, q: Quantity) -> str:
    if group == (WORLD,):
        return q.name
    if len(group) == 1:
        return group[0]
    if line.tie == "all" and line.of == ("*",):
        return q.name
    return "+".join(group)
