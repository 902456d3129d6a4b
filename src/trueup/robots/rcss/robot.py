# SPDX-License-Identifier: Apache-2.0
"""A running RoboCup 3D server as a Robot: its own agent plays a trial's commands, or walks by the task's controller."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from trueup.arrays import Array
from trueup.controllers.controller import Controller, Observation
from trueup.ends import Ended, which_end, with_end
from trueup.engines.simulator import Simulator
from trueup.errors import TrialError, unknown_name
from trueup.recording import Recording
from trueup.robots.rcss.agent import CYCLE, Agent
from trueup.robots.rcss.body import body_named, columns
from trueup.robots.rcss.connection import Connection
from trueup.robots.rcss.log import Log, Look
from trueup.rounding import SAME_INSTANT
from trueup.tasks.task import Task
from trueup.trial import Trial


class RcssRobot:
    """A Robot in a game of rcssservermj (`model` 'T1' or 'K1') or rcssserver3d ('nao').

    A run is a game of its own for the agent: it joins, is beamed to `place` (x, y in m, heading in degrees), takes `settle`
    s for the pose in which the run begins, and leaves afterwards. Commands are angles in rad of the server's joints, or of
    those that `joints` names ({"hip": "-llj3"}: a '-' where it turns the other way); beyond a joint's range they are cut.
    Joints that are not commanded stay at `pose`, else at zero. `kp`, `kd`: of some joints' servos. Where a trial has no
    command, the controller of `task` runs it, which sees and commands as in the model of `simulator`. It waits `timeout` s
    for the server; without a `port`, at the one that is the server's own for agents.
    """

    def __init__(
        self, model: str = "T1", *, host: str = "127.0.0.1", port: int | None = None, team: str = "trueup", number: int = 1,
        place: tuple[float, float, float] = (-3.0, 0.0, 0.0), settle: float = 1.0, timeout: float = 10.0,
        joints: Mapping[str, str] | None = None, pose: Mapping[str, float] | None = None,
        kp: Mapping[str, float] | None = None, kd: Mapping[str, float] | None = None,
        task: Task | None = None, simulator: Simulator | None = None,
    ) -> None:  # fmt: skip
        body = body_named(model)
        self._body = body.renamed(joints or {}).tuned(kp or {}, kd or {})
        own = 3100 if body.simspark else 60000
        self._host, self._port = host, own if port is None else port
        self._team, self._number, self._place = team, number, place
        self._settle, self._timeout = settle, timeout
        self._task, self._look = task, None if simulator is None else Look.of(simulator)
        self.joints = tuple(j.name for j in self._body.joints)
        self._pose = np.zeros(len(self.joints))
        for name, angle in (pose or {}).items():
            self._pose[columns(self._body, [name], "this robot")] = angle

    @property
    def repeatable(self) -> bool:
        """False: nobody resets a running game, so no run is done over unasked."""
        return False

    def perform(self, trial: Trial) -> list[Recording]:
        """See Robot. What was perceived is recorded cycle by cycle, whatever of it the trial observes.

        Raises TrialError where no server answers, falls silent or speaks otherwise, and for a trial with neither a command
        nor a controller; RobotFellError where the robot falls before the run begins; UnknownNameError for other joints or
        channels. A fall in the run is its end, and so is what the trial's `ends` say.
        """
        if trial.command is not None:
            columns(self._body, trial.command.labels, "this robot")
        return [self._run(trial, name) for name in trial.runs]

    def _run(self, trial: Trial, name: str) -> Recording:
        with Connection(self._host, self._port, self._timeout) as line:
            agent = Agent(line, self._body, self._team, self._number, self._timeout)
            agent.beam(self._place)
            agent.ramp(self._start(trial), self._settle)
            agent.restart()
            log, ended = self._played(trial, agent)
        source = f"RoboCup server at {self._host}:{self._port}, {self._body.scene}"
        recording = log.recording(name, trial, source)
        return recording if ended is None else with_end(recording, ended)

    def _start(self, trial: Trial) -> Array:
        """(k,) the pose in which a run begins: that of its first command, else the one that was measured at its start."""
        pose = self._pose.copy()
        given = trial.command if trial.command is not None else trial.initial.get("position")
        if given is not None:
            known = [label for label in given.labels if label in self.joints]
            first = given.select(known).at([trial.start], hold=True)[0]
            pose[columns(self._body, known, "this robot")] = np.where(np.isfinite(first), first, 0.0)
        return self._body.within(pose)

    def _played(self, trial: Trial, agent: Agent) -> tuple[Log, Ended | None]:
        """Cycles of the run up to its end, or to what ended it before."""
        log, decide = Log(agent), self._decider(trial)
        while True:
            now = agent.cycle * CYCLE
            log.perceive(trial.start + now)
            if not now:
                log.check(trial)
            asked = decide(log, now)
            log.order(asked, self._body.within(asked))
            ended = self._ended(trial, agent, log)
            if ended is not None or now >= trial.duration - SAME_INSTANT:
                return log, ended
            agent.move(self._body.within(asked))

    def _decider(self, trial: Trial) -> Callable[[Log, float], Array]:
        """What says after so many s of a run which angles (k,) are asked for."""
        pose, command = self._start(trial), trial.command
        if command is not None:
            at = columns(self._body, command.labels, "this robot")

            def played(log: Log, now: float) -> Array:
                asked = pose.copy()
                asked[at] = command.at([trial.start + now], hold=True)[0]
                return asked

            return played
        make = trial.controller or (self._task.controllers if self._task is not None else None)
        if make is None or self._look is None:
            raise TrialError(
                f"trial '{trial.name}' has neither a command to play nor a task whose controller this robot could run"
            )
        controller = make(np.array([list(trial.settings.values())]))
        return _Controlled(controller, trial, self._look, self.joints, pose)

    def _ended(self, trial: Trial, agent: Agent, log: Log) -> Ended | None:
        """What ends the run now: a fall, or the first of the trial's conditions."""
        if agent.fallen:
            return Ended(log.last, "fallen")
        channels, none = log.latest(), np.zeros((1, 0))
        seen = []
        for end in trial.ends:
            missing = [n for n in end.looks_at if n not in channels]
            if missing and end.name != "fallen":  # a fall is felt without them
                raise unknown_name(
                    "channel", missing[0], channels, f"what this server tells, and end '{end.name}' needs it"
                )
            looked = {n: channels[n].select(x).values for n, x in end.looks_at.items() if n in channels}
            seen.append(None if missing else Observation(log.last - trial.start, none, none, {}, trial, looked))
        known = [(e, s) for e, s in zip(trial.ends, seen, strict=True) if s is not None]
        first = which_end([e for e, _ in known], [s for _, s in known], 1)[0] if known else -1
        return Ended(log.last, known[first][0].name) if first >= 0 else None


class _Controlled:
    """Runs the controller of a simulator's model on the server's robot, at the controller's own rate or the server's."""

    def __init__(self, controller: Controller, trial: Trial, look: Look, joints: tuple[str, ...], pose: Array) -> None:
        self._controller, self._trial, self._look = controller, trial, look
        self._pairs = [(k, look.columns.index(n)) for k, n in enumerate(joints) if n in look.columns]
        if not self._pairs:
            raise unknown_name("joint", joints[0], look.columns, "the simulator's model, and no other of this robot is")
        self._asked, self._due, self._begun = pose, 0.0, False

    def __call__(self, log: Log, now: float) -> Array:
        """(k,) angles in rad."""
        if now < self._due - SAME_INSTANT:
            return self._asked
        seen = log.observation(self._trial, self._look)
        if not self._begun:
            self._controller.reset(seen)
            self._begun = True
        orders = np.asarray(self._controller.command(seen))[0]
        asked = self._asked.copy()
        for k, column in self._pairs:
            asked[k] = orders[column]
        self._asked, self._due = asked, now + self._controller.period
        return asked
