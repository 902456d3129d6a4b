# SPDX-License-Identifier: Apache-2.0
"""A robot simulated by DART: what its file says is read by MuJoCo's reader, what moves it is another engine."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.articulated.declarations import Declaration, declare
from trueup.articulated.pose import ANGLES, AXES, ORIENTATION, POSITION
from trueup.articulated.simulator import ArticulatedSimulator
from trueup.engines.dart.sensors import offered
from trueup.engines.mujoco import model as files
from trueup.engines.mujoco.floor_plane import plane_of
from trueup.errors import MissingExtraError, unknown_name
from trueup.trial import STEP

if TYPE_CHECKING:
    from trueup.engines.dart.copies import DartCopies


TURNING = "base_turning"
"""Channel: angular velocity of a free base about its own axes x, y, z in rad/s."""
OFFERED = (
    "joint.damping", "joint.friction", "joint.armature", "joint.inertia", "joint.slides", "joint.start",
    "joint.start_velocity", "actuator.kp", "actuator.kv", "actuator.zero", "actuator.gain", "actuator.force_limit",
    "actuator.delay", "actuator.servo", "actuator.slides", "actuator.torque", "body.mass", "body.com", "body.inertia",
    "geom.friction", "geom.touches", "world.gravity", "world.floor_friction",
    "world.floor_height", "world.floor_tilt",
)  # fmt: skip
"""Attributes that quantities can read here, and write unless they are only read (see `articulated.model.ATTRIBUTES`)."""


@dataclass(frozen=True, eq=False)
class DartModel:
    """A loaded model (`articulated.model.Engine`), with a free base or fixed."""

    file: files.Model

    @property
    def name(self) -> str:
        """The file's name without its ending."""
        return self.file.name

    def names(self, kind: str) -> tuple[str, ...]:
        """See Model."""
        return self.file.names(kind)

    def drives(self) -> Mapping[str, str]:
        """See Model."""
        return self.file.drives()

    def columns(self) -> Mapping[str, int]:
        """See Model."""
        return self.file.columns()

    @property
    def width(self) -> int:
        """See Model."""
        return self.file.width

    @property
    def floating(self) -> bool:
        """Whether its base is free."""
        types = self.file.compiled.jnt_type
        return bool(len(types)) and int(types[0]) == mujoco.mjtJoint.mjJNT_FREE

    def channels(self) -> Mapping[str, tuple[str, ...]]:
        """See Engine: the file's sensors; the pose of a free base, and its angular velocity about its own axes, in rad/s."""
        return self._channels

    @cached_property
    def _channels(self) -> Mapping[str, tuple[str, ...]]:
        base = {POSITION: AXES, ORIENTATION: ANGLES, TURNING: AXES} if self.floating else {}
        return {**offered(self.file.compiled), **base}

    def get(self, attribute: str, name: str) -> Array:
        """See Model."""
        known = [a for a in OFFERED if not a.startswith("world.floor") or plane_of(self.file.compiled) >= 0]
        if attribute not in known:
            raise unknown_name("attribute", attribute, known, f"what DART offers of '{self.name}'")
        return np.array(self.file.get(attribute, name))

    def copies(self, rows: int) -> DartCopies:
        """See Engine."""
        from trueup.engines.dart.copies import DartCopies

        return DartCopies(self, self.file, rows)


def load(path: str | Path) -> DartModel:
    """An MJCF or URDF file for DART. Raises ModelError, and MissingExtraError where dartpy is not installed."""
    return of(files.load(path))


def of(model: files.Model) -> DartModel:
    """A model that was loaded already, for DART. Raises MissingExtraError where dartpy is not installed."""
    if importlib.util.find_spec("dartpy") is None:
        raise MissingExtraError("Simulation by DART", "dartpy", "dart")
    return DartModel(_with_named_bodies(model))


def _with_named_bodies(model: files.Model) -> files.Model:
    """DART knows bodies by their names, which a file may leave out."""
    if all(model.names("body")):
        return model
    spec, taken = model.spec.copy(), set(model.names("body"))
    for number, body in enumerate(spec.bodies):
        if not body.name:
            body.name = next(n for k in range(len(spec.bodies) + 1) if (n := f"body{number}{'_' * k}") not in taken)
    return replace(model, spec=spec, compiled=spec.compile())


def simulator(model: DartModel, lines: Sequence[Declaration] = (), *, step: float = STEP) -> ArticulatedSimulator:
    """The simulator of a model with declared parameters. `step` in s is that of commands; DART's own is shorter."""
    return ArticulatedSimulator(model, *declare(model, lines), step=step)
