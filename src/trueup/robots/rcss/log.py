# SPDX-License-Identifier: Apache-2.0
"""What was perceived and ordered in a run, cycle by cycle: as a recording, and as controllers see it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.articulated.pose import ANGLES, AXES, ORIENTATION, POSITION, QUATERNION, angles_of
from trueup.controllers.controller import Observation
from trueup.engines.simulator import InPlaceOf, Simulator
from trueup.errors import unknown_name
from trueup.recording import Channel, Recording, is_command
from trueup.robots.rcss.agent import CYCLE, Agent
from trueup.robots.rcss.percept import Percept, Values
from trueup.trial import Trial

Told = Callable[[Percept], Mapping[str, Values]]

_TOLD: Mapping[str, tuple[Told, str, tuple[str, ...]]] = {
    "gyro": (lambda p: p.gyros, "rad/s", AXES),
    "accelerometer": (lambda p: p.accelerometers, "m/s^2", AXES),
    POSITION: (lambda p: p.positions, "m", AXES),
    ORIENTATION: (lambda p: p.orientations, "", QUATERNION),
}
"""Channels of one thing on the torso: how a percept tells it, its unit and its columns."""
_FORCE = ("at.x", "at.y", "at.z", "x", "y", "z")
_SEEN = {"distance": "m", "azimuth": "rad", "elevation": "rad"}


@dataclass(frozen=True)
class Look:
    """How the controllers of a simulator's model see and command it: robots are told apart by names alone."""

    joints: tuple[str, ...]
    """In the order of `Observation.position` and `velocity`, after the base's own where it is free."""
    free: bool
    columns: tuple[str, ...]
    """The joint that each column of a command drives."""
    rest: Mapping[str, float]
    """Angles of joints that the server's robot lacks, in rad."""

    @classmethod
    def of(cls, simulator: Simulator) -> Look | None:
        """That of a simulator of bodies and joints; None of another."""
        whole = simulator
        while isinstance(whole, InPlaceOf):
            whole = whole.whole
        model = getattr(whole, "model", getattr(whole, "engine", None))
        commanded: tuple[str, ...] | None = getattr(whole, "commanded", None)
        if model is None or commanded is None:
            return None
        joints = tuple(model.drives())
        there = Recording("base", {POSITION: Channel(POSITION, AXES, "m", np.zeros(1), np.zeros((1, 3)))})
        free = POSITION in whole.observable(there)
        return cls(joints, free, commanded, {j: float(model.get("joint.start", j)[0]) for j in joints})


class Log:
    """Grows by a cycle at a time."""

    def __init__(self, agent: Agent) -> None:
        self._agent, self._body = agent, agent.body
        self._times: list[float] = []
        self._percepts: list[Percept] = []
        self._joints: list[tuple[Array, Array]] = []
        self._orders: list[tuple[Array, Array]] = []

    def perceive(self, time: float) -> None:
        """Takes down what is perceived at `time`, in s on the trial's clock; a cycle that comes twice counts once."""
        if self._times and time < self._times[-1] + 0.5 * CYCLE:
            for kept in (self._times, self._percepts, self._joints, self._orders):
                kept.pop()
        self._times.append(time)
        self._percepts.append(self._agent.now)
        self._joints.append((self._agent.angles, self._agent.speeds))

    def order(self, asked: Array, sent: Array) -> None:
        """Takes down the orders (k,) in rad that follow."""
        self._orders.append((asked, sent))

    @property
    def last(self) -> float:
        """The latest instant, in s on the trial's clock."""
        return self._times[-1]

    def latest(self) -> dict[str, Channel]:
        """The channels of the latest cycle alone."""
        now = Log(self._agent)
        now.perceive(self.last)
        return now.channels()

    def channels(self) -> dict[str, Channel]:
        """All that is known so far, commands aside; what the server does not tell is absent."""
        time, names = np.array(self._times), tuple(j.name for j in self._body.joints)
        position, velocity = (np.array([row[k] for row in self._joints]) for k in (0, 1))
        made = {"position": Channel("position", names, "rad", time, position)}
        if np.isfinite(velocity).any():
            made["velocity"] = Channel("velocity", names, "rad/s", time, velocity)
        for name, (told, unit, columns) in _TOLD.items():
            values = _table(self._percepts, lambda p, told=told: next(iter(told(p).values()), ()), len(columns))
            if np.isfinite(values).any():
                labels = columns if name in (POSITION, ORIENTATION) else tuple(f"{name}.{c}" for c in columns)
                made[name] = Channel(name, labels, unit, time, values)
        if ORIENTATION in made:
            angles = np.unwrap(angles_of(made[ORIENTATION].values), axis=0)
            made[ORIENTATION] = Channel(ORIENTATION, ANGLES, "rad", time, angles)
        return {**made, **self._several(time)}

    def _several(self, time: Array) -> dict[str, Channel]:
        """Forces, touches, and what was in sight: NaN where it was not."""
        made = {}
        for name, told, columns, units in (
            ("force", lambda p: p.forces, _FORCE, ("m",) * 3 + ("N",) * 3),
            ("touch", lambda p: p.touches, ("",), ("",)),
            ("seen", lambda p: p.seen, tuple(_SEEN), tuple(_SEEN.values())),
        ):
            things = sorted({what for p in self._percepts for what in told(p)})
            if not things:
                continue
            parts = [
                _table(self._percepts, lambda p, told=told, what=what: told(p).get(what, ()), len(columns))
                for what in things
            ]
            labels = tuple(f"{what}.{c}".rstrip(".") for what in things for c in columns)
            made[name] = Channel(name, labels, units[-1], time, np.hstack(parts), units * len(things))
        return made

    def check(self, trial: Trial) -> None:
        """Raises UnknownNameError for what a trial observes and this robot does not tell."""
        channels = self.channels()
        for name, o in trial.observed.items():
            if is_command(name):
                continue
            if name not in channels:
                raise unknown_name("channel", name, channels, "what this server tells")
            if name != "seen":  # what comes in sight later is not known yet
                channels[name].select(o.labels)

    def recording(self, name: str, trial: Trial, source: str) -> Recording:
        """The run. A trial's command is recorded as it was asked for; what was sent, cut to the joints' ranges, beside it."""
        time, names = np.array(self._times), tuple(j.name for j in self._body.joints)
        asked, sent = (np.array([row[k] for row in self._orders]) for k in (0, 1))
        channels = self.channels()
        if trial.command is not None:
            labels = trial.command.labels
            columns = [names.index(label) for label in labels]
            channels["command"] = trial.command.replace(name="command")
            channels["command_sent"] = Channel("command_sent", labels, "rad", time, sent[:, columns])
        else:
            channels["command"] = Channel("command", names, "rad", time, asked)
            if not np.array_equal(asked, sent):
                channels["command_sent"] = Channel("command_sent", names, "rad", time, sent)
        return Recording(name, channels, {"source": source})

    def observation(self, trial: Trial, look: Look) -> Observation:
        """What a controller sees at the end of the log, in the layout of its simulator."""
        now, latest = self._percepts[-1], self._joints[-1]
        own = {j.name: k for k, j in enumerate(self._body.joints)}
        position = [latest[0][own[n]] if n in own else look.rest.get(n, 0.0) for n in look.joints]
        velocity = [latest[1][own[n]] if n in own else 0.0 for n in look.joints]
        if look.free:
            place = next(iter(now.positions.values()), (np.nan,) * 3)
            turn = next(iter(now.orientations.values()), (np.nan,) * 4)
            position = [*place, *turn, *position]
            before = next(iter(self._percepts[max(len(self._percepts) - 2, 0)].positions.values()), (np.nan,) * 3)
            moved = [(a - b) / CYCLE for a, b in zip(place, before, strict=True)]
            velocity = [*moved, *next(iter(now.gyros.values()), (np.nan,) * 3), *velocity]
        sensors: dict[str, Array] = {}
        for name, several in (("gyro", now.gyros), ("accelerometer", now.accelerometers)):
            for k, (there, values) in enumerate(several.items()):
                sensors[there] = np.array([values])
                if k == 0:
                    sensors[name] = sensors[there]
        at = self._times[-1] - trial.start
        return Observation(at, np.array([position]), np.array([velocity]), sensors, trial)


def _table(percepts: list[Percept], told: Callable[[Percept], Values], width: int) -> Array:
    """(T, width), NaN where a percept does not tell it."""
    return np.array([told(p) or (np.nan,) * width for p in percepts])
