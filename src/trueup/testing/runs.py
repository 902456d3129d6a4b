# SPDX-License-Identifier: Apache-2.0
"""What happens inside the runs of a simulator: whose controller acts, what ends a run, what chance does to it.

A simulator that has no controllers, ends, disturbances or sensors says so with a ModelError
(`engines.simulator.refuse_unsupported`); one that ignores what a trial declares breaks the contract.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from trueup.arrays import Array
from trueup.chance import Disturbance, Sensing, StartScatter
from trueup.controllers.controller import Observation
from trueup.ends import LOOK, When
from trueup.engines.simulator import Rollout, Simulator
from trueup.errors import ModelError, TrialError
from trueup.rounding import SAME_INSTANT
from trueup.testing.broken import require
from trueup.trial import Trial


class _Witness:
    """A controller that commands nothing and remembers which trials it saw, and how many copies."""

    period = 0.05

    def __init__(self, copies: int, width: int) -> None:
        self._copies, self._width = copies, width
        self.trials: list[Trial | None] = []
        self.rows: set[int] = set()

    def reset(self, observation: Observation) -> None:
        """See Controller."""
        self._see(observation)

    def command(self, observation: Observation) -> Array:
        """See Controller."""
        self._see(observation)
        return np.zeros((self._copies, self._width))

    def _see(self, observation: Observation) -> None:
        self.trials.append(observation.trial)
        self.rows.add(len(observation.position))


def check_runs(simulator: Simulator, trial: Trial, short: Trial, values: Array, width: int | None) -> None:
    """Checks two trials, the second of them shorter, with values (b, n). Raises ContractBrokenError."""
    _check_controllers(simulator, trial, short, values, width)
    _check_ends(simulator, trial, values)
    name, observed = next(iter(trial.observed.items()))
    size = float(np.nanstd(trial.initial[name].values)) if name in trial.initial else 1.0
    _check_chance(simulator, trial, values, "disturbances", StartScatter(name, 0.01 * size + 1e-6, observed.labels[:1]))
    _check_chance(simulator, trial, values, "sensing", Sensing(name, 0.01 * size + 1e-6, 0.0, observed.labels[:1]))


def _supported(work: Callable[[], list[Rollout]], simulator: Simulator, kind: str) -> list[Rollout] | None:
    """The rollouts, or None where the simulator says that it does not support such a thing."""
    try:
        return work()
    except ModelError as error:
        words = str(error)
        require(
            kind in words and simulator.name in words,
            f"a ModelError that is to say '{kind}' is not supported must name it and the simulator; it says: {words}",
        )
        return None


def _check_controllers(simulator: Simulator, trial: Trial, short: Trial, values: Array, width: int | None) -> None:
    commands = width or (len(trial.command.labels) if trial.command is not None else 0)
    if not commands:
        return
    made: list[_Witness] = []

    def witness(values: Array) -> _Witness:
        made.append(_Witness(len(values), commands))
        return made[-1]

    if _supported(lambda: simulator.rollout([short, trial], values, witness), simulator, "controller") is None:
        return
    for one in made:
        require(None not in one.trials, "Observation.trial is None: a controller cannot know which trial it is in")
        require(
            len({t.name for t in one.trials if t}) == 1, "one controller saw several trials; each trial has its own"
        )
        require(one.rows == {len(values)}, f"a controller of {len(values)} copies saw {sorted(one.rows)} rows")
    seen = {t.name for one in made for t in one.trials if t is not None}
    require(
        seen == {trial.name, short.name}, f"controllers saw the trials {', '.join(sorted(seen))}, not those of the call"
    )
    made.clear()
    own: list[_Witness] = []
    mine = replace(trial, controller=lambda values: own.append(_Witness(len(values), commands)) or own[-1])
    simulator.rollout([short, mine], values, witness)
    require(len(own) == 1 and len(made) == 1, "a trial's own controller goes before the one of the call, for it alone")


def _check_ends(simulator: Simulator, trial: Trial, values: Array) -> None:
    half = 0.5 * trial.duration
    ending = replace(trial, ends=(When("half time", lambda seen: np.full(len(seen.position), seen.time >= half)),))
    done = _supported(lambda: simulator.rollout([trial, ending], values), simulator, "ends")
    if done is None:
        return
    whole, ended = done
    require(
        sorted(ended.ends) == list(range(len(values))), "an end that is reached is not in Rollout.ends for each row"
    )
    require(not ended.failures, "an end is an outcome, not a failure")
    for end in ended.ends.values():
        late = end.at - trial.start - half
        require(end.name == "half time", f"a run ended as '{end.name}', the condition is called 'half time'")
        require(
            -SAME_INSTANT <= late <= LOOK + 2.0 * simulator.step, f"an end was seen {late:.3g} s after it was reached"
        )
    for name, channel in ended.channels.items():
        lasted = ended.lasted(name)
        same = np.array_equal(channel[lasted], whole.channels[name][lasted])
        require(same, f"channel '{name}' before an end is not what it is without one")
        require(bool(np.isnan(channel[~lasted]).all()), f"channel '{name}' has samples after the end of its run")


def _check_chance(
    simulator: Simulator, trial: Trial, values: Array, kind: str, declared: Disturbance | Sensing
) -> None:
    plain = replace(trial, **{kind: (declared,)})
    alike = np.repeat(values[:1], 2, axis=0)

    def run(seed: int, *, together: bool = False) -> list[Rollout]:
        return simulator.rollout([plain.seeded(np.random.default_rng(seed), alike=together)], alike)

    first = _supported(lambda: run(0), simulator, kind)
    if first is None:
        return
    name = next(iter(trial.observed))
    rows = first[0].channels[name]
    require(np.array_equal(rows, run(0)[0].channels[name]), f"{kind}: the same seed gave other runs")
    require(not np.array_equal(rows, run(1)[0].channels[name]), f"{kind}: another seed gave the same runs")
    require(not np.array_equal(rows[0], rows[1]), f"{kind}: two rows met the same chance")
    pair = run(0, together=True)[0].channels[name]
    require(np.array_equal(pair[0], pair[1]), f"{kind}: rows that are to meet the same chance differ")
    (alone,) = simulator.rollout([plain.seeded(np.random.default_rng(0))], alike[:1])
    require(np.array_equal(rows[:1], alone.channels[name]), f"{kind}: what a row meets depends on its neighbours")
    try:
        simulator.rollout([plain], values)
    except TrialError:
        return
    require(False, f"{kind} without a seed must raise a TrialError (take `Trial.settled`)")
