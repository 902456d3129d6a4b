# SPDX-License-Identifier: Apache-2.0
"""What to calibrate of a humanoid on a few whole runs when nobody says: what such runs tell, and how wrong it may be.

J. Tan et al., IROS 2016, section VI: gains of all servos alike and the centre of mass of each body, alike on both sides; and
what their robot surely had too: weaker drives, commands that come late, horns put on askew, other masses, another floor. A
run of seconds does not tell ten servos apart, as minutes of an arm do.
"""

from __future__ import annotations

from collections.abc import Sequence

from trueup.articulated.assignments import Assignment
from trueup.articulated.declarations import Declaration
from trueup.articulated.pose import ORIENTATION, POSITION
from trueup.articulated.quantities.known import quantity
from trueup.engines.mujoco.base import free_joint
from trueup.engines.mujoco.floor_plane import plane_of
from trueup.engines.mujoco.model import Model
from trueup.parameters import Parameter, ParameterSpace

_FACTORS = {
    "kp": 3.0,
    "kv": 3.0,
    "damping": 3.0,
    "friction": 5.0,
    "armature": 3.0,
    "force_limit": 1.5,
    "mass": 1.5,
    "floor_friction": 2.0,
}
"""How far off a model file may well be, to each side: of the size of the balancing study's boxes (`wider.toml` there), about
the file's own values. Chosen on the small humanoid of `examples`."""
_ASTRAY = 0.05
"""To each side: in rad of a servo's zero, in s of a sensor's delay, of the base's height of a body's centre of mass."""

Kind = tuple[float, ...]


def whole_body_lines(model: Model) -> list[Declaration]:
    """Declarations for a model with a free base whose servos are commanded by position."""
    compiled = model.compiled
    driven = {j: i for j, i in model.actuator_of_joint().items() if model.is_position_servo(i)}
    lines: list[Declaration] = []
    kinds = _alike(model, driven)
    for number, joints in enumerate(kinds):
        label = f"servos{number + 1}." if len(kinds) > 1 else ""
        for name in ("kp", "kv", "damping", "friction", "armature", "force_limit"):
            q = quantity(name)
            at = q.choices(model, {}).get(joints[0]) if q.family == "actuator" else joints[0]
            if at is not None and _has(model, name, at, driven[joints[0]]):
                lines.append(Declaration(name, tuple(joints), tie="all", name=label + name))
    lines.append(Declaration("delay", tuple(driven), tie="all", name="delay"))
    lines.append(Declaration("zero", tuple(driven), tie="mirror"))
    base = int(compiled.jnt_bodyid[free_joint(compiled)])
    moved = [
        compiled.body(i).name for i in range(1, compiled.nbody) if compiled.body_rootid[i] == compiled.body_rootid[base]
    ]
    heavy = tuple(n for n in moved if n and model.get("body.mass", n)[0] > 0.0)
    lines += [Declaration(name, heavy, tie="mirror") for name in ("mass", "com_x", "com_y", "com_z")]
    lines.append(Declaration("sensor_delay", (f"{POSITION}+{ORIENTATION}",), name="capture"))
    if plane_of(compiled) >= 0:
        lines.append(Declaration("floor_friction"))
    return lines


def as_wrong_as_may_be(model: Model, space: ParameterSpace, assignments: Sequence[Assignment]) -> ParameterSpace:
    """The space with bounds that say how wrong the file may well be, which is what whole runs are weighed against."""
    compiled = model.compiled
    height = float(compiled.qpos0[compiled.jnt_qposadr[free_joint(compiled)] + 2])
    every = zip(space.parameters, assignments, strict=True)
    return ParameterSpace(tuple(_near(p, a.kind, abs(height)) for p, a in every))


def _near(p: Parameter, kind: str, height: float) -> Parameter:
    if kind in _FACTORS and p.nominal > 0.0:
        return p.replace(lower=p.nominal / _FACTORS[kind], upper=p.nominal * _FACTORS[kind])
    half = _ASTRAY * (height if kind.startswith("com_") else float(kind in ("zero", "sensor_delay")))
    return p.replace(lower=p.nominal - half, upper=p.nominal + half) if half > 0.0 else p


def _alike(model: Model, driven: dict[str, int]) -> list[list[str]]:
    """Joints by what the file says of their servo: those of one make are alike in all that counts."""
    kinds: dict[Kind, list[str]] = {}
    for joint, actuator in driven.items():
        c, dof = model.compiled, int(model.compiled.jnt_dofadr[model.index("joint", joint)])
        own = (*c.actuator_gainprm[actuator, :1], *c.actuator_biasprm[actuator, :3], *c.actuator_forcerange[actuator],
               *c.actuator_gear[actuator, :1] ** 2, c.dof_damping[dof], c.dof_frictionloss[dof])  # fmt: skip
        kinds.setdefault(tuple(round(float(x), 9) for x in own), []).append(joint)
    return list(kinds.values())


def _has(model: Model, name: str, target: str, actuator: int) -> bool:
    """Whether the file has any of it; what is zero there is no number that could be wrong by a factor."""
    if name == "force_limit":
        return bool(model.compiled.actuator_forcelimited[actuator])
    return quantity(name).nominal(model, target) > 0.0
