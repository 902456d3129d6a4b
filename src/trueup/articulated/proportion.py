# SPDX-License-Identifier: Apache-2.0
"""Which parameters of a robot of joints and links grow with the masses of its model."""

from __future__ import annotations

from collections.abc import Sequence

from trueup.articulated.assignments import Assignment
from trueup.articulated.model import Model
from trueup.articulated.quantities.known import quantity
from trueup.parameters import ParameterSpace
from trueup.proportion import Proportion

_FORCES = ("N", "kg")
"""How units begin of what grows with the masses: forces, stiffnesses, damping, masses, inertias."""


def grown(model: Model, space: ParameterSpace, assignments: Sequence[Assignment]) -> dict[str, str]:
    """What of `space` grows with the masses, by name, each with the joint that it is of, "" where that is several or none."""
    joints, found = {drive: joint for joint, drive in model.drives().items() if drive}, {}
    for p, a in zip(space.parameters, assignments, strict=False):
        if not p.frozen and p.unit.startswith(_FORCES) and a.quantity.family in ("joint", "actuator"):
            of = {joints.get(target, target) for target in a.targets}
            found[p.name] = of.pop() if len(of) == 1 else ""
    return found


def proportion(model: Model, space: ParameterSpace, assignments: Sequence[Assignment]) -> Proportion | None:
    """What is searched of it in `space`; None where a motor's torque is taken as it is told beside its joint's drive."""
    named = [(p, a) for p, a in zip(space.parameters, assignments, strict=False) if not p.frozen]
    drives = model.drives()
    motors = {d for d in drives.values() if d and model.get("actuator.torque", d)[0] > 0.0}
    own = {d: p.name for p, a in named if a.kind == "gain" for d in a.targets if d in motors}
    touched = {drives.get(t, t) for _, a in named for t in a.targets} & motors
    if not own or touched - own.keys():
        return None
    searched = {t for _, a in named if a.kind == "mass" or a.quantity.group == "inertia" for t in a.targets}
    heavy = tuple(b for b in quantity("mass").choices(model, {}) if model.get("body.mass", b)[0] > 0.0)
    grow = [(p.name, a) for p, a in named if a.kind == "gain" or p.unit.startswith(_FORCES)]
    of = {name: next((own[d] for t in a.targets if (d := drives.get(t, t)) in own), "") for name, a in grow}
    return Proportion(
        tuple(dict.fromkeys(own.values())),
        of,
        tuple(b for b in heavy if b not in searched),
        quantity("mass").bounds(1.0)[1],
    )
