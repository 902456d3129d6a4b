# SPDX-License-Identifier: Apache-2.0
"""What an engine offers of a robot: its names, attributes that are read and written by name, and copies that are stepped.

An attribute is `family.attribute` of one named element, in SI units. (b, ...) has one row for each copy of the model; a
model as it was loaded is one copy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from trueup.arrays import Array, Integers

ATTRIBUTES: Mapping[str, str] = {
    "joint.damping": "viscous friction, N m s/rad",
    "joint.damping_quadratic": "friction growing with speed squared, N m s2/rad2",
    "joint.friction": "Coulomb friction, N m",
    "joint.creep": "how much a joint creeps that friction holds, as a share (0: it sticks)",
    "joint.armature": "rotor inertia, kg m2",
    "joint.backlash": "gap between drive and link, end to end, rad; the joint's position is that of the link",
    "joint.gear_backlash": "the same, where the joint's position is that of the drive",
    "joint.gear_compliance": "twist of the gear between drive and link for a torque, rad/(N m); the position is the drive's",
    "joint.spring": "stiffness of a spring at the joint, N m/rad",
    "joint.spring_cubic": "by how much that stiffness grows with the square of the way from rest, N m/rad3",
    "joint.spring_rest": "position in which this spring pushes to neither side, rad",
    "joint.stop_lower": "where a hard stop ends the joint's way below, rad",
    "joint.stop_upper": "the same above",
    "joint.inertia": "inertia that the joint moves in the model's own posture, kg m2; only read",
    "joint.slides": "1 where the joint slides (then m for rad and N for N m everywhere), else 0; only read",
    "joint.start": "position from which a run begins where nothing was measured, rad; only read",
    "joint.start_velocity": "the same for its speed, rad/s; only read",
    "actuator.kp": "stiffness of a position servo: force = gain (kp (command + zero - position) - kv velocity), N m/rad",
    "actuator.kv": "damping of a position servo, N m s/rad",
    "actuator.zero": "zero error of the servo's own sensor, rad",
    "actuator.gain": "factor on the actuator's whole force",
    "actuator.force_limit": "largest force on either side, N m; 0 for none",
    "actuator.delay": "delay of the command, s",
    "actuator.servo": "1 where the actuator is a position servo, else 0; only read",
    "actuator.slides": "1 where its joint slides, else 0; only read",
    "actuator.torque": "force per unit of the command where it is a plain motor, else 0; only read",
    "body.mass": "mass, kg; written it scales the inertia along, so that the body keeps its shape",
    "body.com": "(b, 3) centre of mass in the body frame, m",
    "body.held": "share of the body's weight that something beside the drives holds: a controller that compensates gravity",
    "body.inertia": "(b, 3, 3) rotational inertia about the centre of mass in the body frame, kg m2",
    "geom.friction": "sliding friction of a shape's contacts",
    "geom.softness": "time constant of a shape's contacts, s",
    "geom.touches": "1 where a shape can touch anything, 0 where it is for the eye alone; only read",
    "world.step": "s, of the simulation; only read",
    "world.gravity": "(b, 3) m/s2",
    "world.floor_height": "height of the plane that the robot stands on, m",
    "world.floor_tilt": "(b, 2) how far that plane is turned about the world's x, then y, from where the model has it, rad",
    "world.floor_friction": "its sliding friction",
}
"""What quantities read and write. An engine offers those that it can; any other name is its own."""

WORLD = "world"
"""The one element of the family 'world'."""


@dataclass(frozen=True, eq=False)
class BasePose:
    """Where a free base is and how it moves, (3,) each, or (b, 3) where each copy is placed by itself."""

    position: Array
    """m, in the world."""
    velocity: Array
    """m/s, in the world."""
    angles: Array
    """Roll, pitch, yaw (see `articulated.pose`), rad."""
    rates: Array
    """How fast these change, rad/s."""


class Attributes(Protocol):
    """b copies of a model, of which named attributes can be read."""

    def get(self, attribute: str, name: str) -> Array:
        """(b,) or (b, ...) present values, of which the caller may change its own copy.

        Raises UnknownNameError for an element that is not there or an attribute that this engine does not offer.
        """
        ...


class Model(Attributes, Protocol):
    """A robot as it was loaded: one copy."""

    @property
    def name(self) -> str:
        """For reports and messages."""
        ...

    def names(self, kind: str) -> tuple[str, ...]:
        """All names of one family: 'actuator', 'body', 'geom'."""
        ...

    def drives(self) -> Mapping[str, str]:
        """Hinge and slide joints that move, in order, each to the name of the actuator that drives it, '' where none does."""
        ...

    def columns(self) -> Mapping[str, int]:
        """Actuators, each to its column in the commands (b, width)."""
        ...

    @property
    def width(self) -> int:
        """Number of columns of the commands."""
        ...


class Writable(Attributes, Protocol):
    """b copies of a model, of which named attributes can be read and written."""

    def set(self, attribute: str, name: str, values: Array) -> None:
        """Writes (b,) or (b, ...). Raises as `get` does."""
        ...


class Copies(Writable, Protocol):
    """b simulations that are stepped together, as what acts in each step sees them."""

    def reader(self, state: str, joints: Sequence[str]) -> Callable[[int], Array]:
        """What reads `state` of joints, first n copies to (n, k): 'position', 'velocity', the drives' 'force', or, where the
        engine offers it, the 'bias' with which gravity and motion push against them.

        So it does for one of `Engine.channels`, with its labels in place of joints.
        """
        ...

    def writer(self, attribute: str, names: Sequence[str]) -> Callable[[Array], None]:
        """What writes an attribute of several elements at once: (n, k) into the first n copies."""
        ...


class Running(Copies, Protocol):
    """Copies that can be placed and stepped. Joints are those of `Model.drives()`, in order."""

    @property
    def position(self) -> Array:
        """(b, k) of the joints, rad or m."""
        ...

    @property
    def velocity(self) -> Array:
        """(b, k)."""
        ...

    def place(self, position: Array, velocity: Array, base: BasePose | None = None) -> None:
        """Puts the joints somewhere, (b, k) each, and a free base where it was measured to be."""
        ...

    def step(self, command: Array, step: float) -> None:
        """One step of `step` s with commands (b, width). A copy that blows up shows values that are not finite."""
        ...


@runtime_checkable
class Stopping(Protocol):
    """Copies of which some can be left out of further steps while the others go on."""

    def stop(self, rows: Integers) -> None:
        """These are stepped no further."""
        ...


@runtime_checkable
class Pushable(Protocol):
    """Copies whose bodies can be pushed."""

    def push(self, body: str, force: Array) -> None:
        """A force (b, 3) in N, in the world, on the centre of mass of a body, from now on until it is set again."""
        ...


@runtime_checkable
class Subdivided(Protocol):
    """Copies that divide a step where it is longer than they can take."""

    substep: float
    """s"""


def step_of(copies: object, step: float) -> float:
    """How long the steps are, in s, that copies take in one of `step`."""
    return min(step, copies.substep) if isinstance(copies, Subdivided) else step


class Engine(Model, Protocol):
    """A model that can be simulated: all that `articulated.simulator.ArticulatedSimulator` needs."""

    def copies(self, rows: int) -> Running:
        """That many copies, as they were loaded."""
        ...

    def channels(self) -> Mapping[str, tuple[str, ...]]:
        """What can be measured beside joints, each with its labels: sensors, `base_position`, `base_orientation`."""
        ...


def servos(model: Model) -> tuple[str, ...]:
    """Names of the position servos of a model."""
    return tuple(n for n in model.names("actuator") if n and model.get("actuator.servo", n)[0])
