# SPDX-License-Identifier: Apache-2.0
"""What may be calibrated in joints: friction in its forms, rotor inertia, springs, backlash, gears that twist."""

from __future__ import annotations

import numpy as np

from trueup.articulated.laws import STRIBECK_SPEED, VaryingFriction
from trueup.articulated.model import Model
from trueup.articulated.quantities.quantity import Quantity, around, between, factor
from trueup.errors import UnknownNameError
from trueup.samples import SLIGHT

BANDWIDTH = 2.0 * np.pi * 5.0
"""rad/s: servos of arms, hands and legs follow at some hertz."""


def _servo_force(model: Model, joint: str, hinge: float, slide: float) -> float:
    """What the joint's servo pushes with, `hinge` rad or `slide` m away from its command; 0 where it has none."""
    actuator = model.drives().get(joint, "")
    if not actuator or not model.get("actuator.servo", actuator)[0]:
        return 0.0
    away = slide if model.get("joint.slides", joint)[0] else hinge
    return away * float(model.get("actuator.kp", actuator)[0])


def _driven(model: Model, joint: str, hinge: float, slide: float) -> float:
    """The same, of a servo of speed too: as one of position that moves as much as fast (`BANDWIDTH`). 0 where an engine
    knows no servos.
    """
    if (force := _servo_force(model, joint, hinge, slide)) or not (actuator := model.drives().get(joint, "")):
        return force
    try:
        gain, damping = (float(model.get(f"actuator.{name}", actuator)[0]) for name in ("kp", "kv"))
    except UnknownNameError:
        return 0.0
    away = slide if model.get("joint.slides", joint)[0] else hinge
    return away * BANDWIDTH * gain if gain == damping else 0.0  # force = gain * (command - speed)


def _held(model: Model, joint: str) -> float:
    """Friction that the servo would hold against with 0.1 rad or 0.02 m of error."""
    return _driven(model, joint, 0.1, 0.02)


def _lagging(model: Model, joint: str) -> float:
    """Damping with which the joint would follow its servo with a lag of half a second."""
    return _driven(model, joint, 0.5, 0.5)


_GEARED, _SCREWED = 5.0, 20.0
"""Times what a hinge or a slide moves that its rotor may be behind the gear or the screw: a worm's elbow has 2.6, the lift of
a SCARA by a ball screw of 20 mm a turn 11."""


def _moved(model: Model, joint: str) -> float:
    """The inertia that the joint moves."""
    return float(model.get("joint.inertia", joint)[0])


def _geared(model: Model, joint: str) -> float:
    """Rotor inertia that leaves what the joint moves a small part of it."""
    return (_SCREWED if model.get("joint.slides", joint)[0] else _GEARED) * _moved(model, joint)


def _light(model: Model, joint: str) -> float:
    """Rotor inertia that hardly adds to what the joint moves: a finger moves less than the least rotor of an arm."""
    return SLIGHT * _moved(model, joint)


def _free(model: Model, joint: str) -> float:
    """What slows a joint that no servo holds by a slight part of 1 rad/s (or m/s) in a second: a small pendulum's bearing has
    less than the least gear of an arm, and the pendulum swings on for as long as logs are. 0 where an engine does not say.
    """
    try:
        return 0.0 if _servo_force(model, joint, 1.0, 1.0) else SLIGHT * _moved(model, joint)
    except UnknownNameError:
        return 0.0


def _springy(model: Model, joint: str) -> float:
    """Stiffness that holds the joint as its servo does, or lets it swing at 5 Hz by itself."""
    return max(_servo_force(model, joint, 1.0, 1.0), _moved(model, joint) * BANDWIDTH**2)


_BENT = {0.0: 0.5, 1.0: 0.05}
"""rad or m (of a slide) from rest, where a spring's stiffening may at most be as much as the stiffness that is sought."""


def _stiffening(model: Model, joint: str) -> float:
    """Growth of a spring's stiffness that makes as much of it on a usual way as `_springy`."""
    return _springy(model, joint) / _BENT[float(model.get("joint.slides", joint)[0])] ** 2


JOINTS = (
    Quantity(
        name="damping", family="joint", unit="N m s/rad", title="viscous friction", scale="log",
        bounds=factor(100, 50, 0.05), attributes=("joint.damping",), start=None, reach=_lagging, little=_free,
        shown_by="steady motion at several speeds",
    ),
    Quantity(
        name="damping_quadratic", family="joint", unit="N m s2/rad2", title="friction growing with speed squared",
        bounds=between(0.0, 5.0), attributes=("joint.damping_quadratic",), start=None, shown_by="fast steady motion",
    ),
    Quantity(
        name="friction", family="joint", unit="N m", title="Coulomb friction", scale="log", bounds=factor(100, 50, 0.05),
        attributes=("joint.friction",), start=None, reach=_held, little=_free, shown_by="slow reversals",
    ),
    Quantity(
        name="friction_creep", family="joint", unit="", title="creep of a joint held by friction", scale="log",
        bounds=lambda nominal: (1e-4, 0.2), attributes=("joint.creep",), start=None, shown_by="long holds under load",
    ),
    Quantity(
        name="friction_static", family="joint", unit="N m", title="breakaway above Coulomb friction",
        bounds=between(0.0, 2.0), law=VaryingFriction, nothing=0.0, reach=_held,
        shown_by="starts from rest and slow reversals",
    ),
    Quantity(
        name="stribeck_speed", family="joint", unit="rad/s", title="Stribeck speed", scale="log",
        bounds=factor(10, 10, 0.05), law=VaryingFriction, start=STRIBECK_SPEED,
    ),
    Quantity(
        name="friction_load", family="joint", unit="", title="friction that grows with load", bounds=between(0.0, 1.0),
        law=VaryingFriction, start=0.05, nothing=0.0,  # at zero no slope leads away from sticking
    ),
    Quantity(
        name="armature", family="joint", unit="kg m2", title="rotor inertia", scale="log", bounds=factor(100, 50, 0.005),
        attributes=("joint.armature",), start=None, reach=_geared, little=_light,
        shown_by="fast accelerations (chirps, steps)",
    ),
    Quantity(
        name="spring", family="joint", unit="N m/rad", title="stiffness of a spring at the joint",
        bounds=between(0.0, 0.1), attributes=("joint.spring",), start=None, reach=_springy,
        shown_by="slow motion through the whole range",
    ),
    Quantity(
        name="spring_cubic", family="joint", unit="N m/rad3", title="stiffening of a spring at the joint",
        bounds=between(0.0, 0.1), attributes=("joint.spring_cubic",), start=None, reach=_stiffening,
        shown_by="slow motion through the whole range",
    ),
    Quantity(
        name="spring_rest", family="joint", unit="rad", title="position in which the joint's spring is at rest",
        bounds=around(np.pi), attributes=("joint.spring_rest",), start=None,
        shown_by="slow motion through the whole range",
    ),
    Quantity(
        name="backlash", family="joint", unit="rad", title="backlash, end to end", bounds=between(0.0, 0.1),
        attributes=("joint.backlash",), start=0.005, needs="slack", shown_by="slow reversals without load",
    ),
    Quantity(
        name="gear_backlash", family="joint", unit="rad", title="backlash behind the encoder, end to end",
        bounds=between(0.0, 0.1), attributes=("joint.gear_backlash",), needs="gear",
        shown_by="slow reversals without load",
    ),
    Quantity(
        name="gear_compliance", family="joint", unit="rad/(N m)", title="twist of the gear behind the encoder",
        bounds=between(0.0, 0.1), attributes=("joint.gear_compliance",), needs="gear", turn=1,
        shown_by="fast accelerations (chirps, steps)",
    ),
    *(
        Quantity(name=f"stop_{side}", family="joint", unit="rad", title=f"{side} hard stop", bounds=around(0.05),
                 attributes=(f"joint.stop_{side}",), start=None, needs="stop",
                 shown_by="pressing against the stop")
        for side in ("lower", "upper")
    ),
)  # fmt: skip
