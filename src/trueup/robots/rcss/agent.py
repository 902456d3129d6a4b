# SPDX-License-Identifier: Apache-2.0
"""One agent in a running game: it joins, is put somewhere, and answers what it perceives with what its joints are to do."""

from __future__ import annotations

import math
import time

import numpy as np

from trueup.arrays import Array
from trueup.articulated.pose import up_of
from trueup.ends import TILT
from trueup.errors import RobotFellError, TrialError
from trueup.robots.rcss.body import Body
from trueup.robots.rcss.connection import Connection
from trueup.robots.rcss.percept import Percept, percept
from trueup.rounding import PRINTED
from trueup.units import GRAVITY

CYCLE = 0.02
"""s from one message to the next, of both servers."""
_STEADY = 0.5
"""s over which an accelerometer is averaged into which way is up."""


class Agent:
    """Joins a server's game. `now` is what was perceived last, `cycle` how many cycles passed since `restart`."""

    def __init__(self, line: Connection, body: Body, team: str, number: int, patience: float) -> None:
        self._line, self.body = line, body
        self.cycle, self._began, self._up = 0, math.nan, np.eye(3)[2]
        for message in body.joining(team, number):
            line.send(message)
            self.now = self._heard()
        until = time.monotonic() + patience
        while not self.now.joints or math.isnan(
            self.now.time
        ):  # the first messages of SimSpark are about the field alone
            if time.monotonic() > until:
                raise TrialError(f"the server took '{body.scene}' in, but said nothing of joints for {patience:g} s")
            self._say("")
        missing = [j.perceptor for j in body.joints if j.perceptor not in self.now.joints]
        if missing:
            raise TrialError(
                f"the server's robot has no joint perceptor '{missing[0]}'; it has: {', '.join(self.now.joints)}. Is it a "
                f"'{body.scene}'?"
            )
        self.restart()

    @property
    def angles(self) -> Array:
        """(k,) of the body's joints, in rad."""
        return np.array([j.sign * self.now.joints[j.perceptor] for j in self.body.joints])

    @property
    def speeds(self) -> Array:
        """(k,) in rad/s; NaN of joints of which the server does not say it."""
        return np.array([j.sign * self.now.speeds.get(j.perceptor, math.nan) for j in self.body.joints])

    @property
    def fallen(self) -> bool:
        """Whether it leans more than anyone does who stands."""
        return bool(self._up[2] < math.cos(TILT) * np.linalg.norm(self._up))

    def restart(self) -> None:
        """Counts cycles from now on."""
        self.cycle, self._began = 0, self.now.time

    def beam(self, place: tuple[float, float, float]) -> None:
        """To x, y in m and a heading in degrees, joints at zero: as both servers do before a kick-off."""
        self._say(f"(beam {place[0]:.4f} {place[1]:.4f} {place[2]:.3f})")
        self._up = np.eye(3)[2]

    def move(self, target: Array) -> None:
        """Orders the joints to `target` (k,) in rad and perceives the next cycle."""
        self._say(self.body.order(target, self.angles))

    def ramp(self, target: Array, seconds: float) -> None:
        """Brings the joints to `target` (k,) in half of so many seconds, and holds them there.

        Raises RobotFellError where it falls by that.
        """
        first, count = self.angles, max(round(seconds / CYCLE), 1)
        for k in range(count):
            share = min(2.0 * (k + 1) / count, 1.0)
            self.move(first + share * (target - first))
            if self.fallen:
                raise RobotFellError(
                    f"the robot fell after {k * CYCLE:.1f} s on its way to the pose that a run begins in"
                )

    def _say(self, message: str) -> None:
        """Sends effector messages and takes in the next cycle."""
        self._line.send(message + "(syn)")
        self.now = self._heard()
        if math.isnan(self._began):
            return
        if self.now.time < self._began:
            raise TrialError(
                f"the server's clock ran back from {self._began:.2f} to {self.now.time:.2f} s: it was restarted"
            )
        passed = self.now.time - self._began
        self.cycle += 1
        # Servers cut their time to hundredths, so that one cycle looks like 10, 20 or 30 ms: beyond, some were missed.
        if abs(passed - self.cycle * CYCLE) > 0.5 * CYCLE + PRINTED:
            self.cycle = round(passed / CYCLE)
        if self.now.orientations:
            self._up = up_of(np.array(next(iter(self.now.orientations.values()))))
        elif self.now.accelerometers:
            felt = np.array(next(iter(self.now.accelerometers.values())))
            self._up = self._up + CYCLE / _STEADY * (felt / GRAVITY - self._up)

    def _heard(self) -> Percept:
        return percept(self._line.receive())
