# SPDX-License-Identifier: Apache-2.0
"""Inside a run: whose controller acts, what ends it, what chance does to it. The laws of physics say what must come out."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.articulated.declarations import Declaration, declare
from trueup.chance import Buffeting, Chance, CommandNoise, Disturbance, Push, Sensing, StartScatter
from trueup.controllers.controller import Observation
from trueup.controllers.playback import Playback
from trueup.ends import LOOK, Arrived, Fallen, Left, When, ended
from trueup.engines.mujoco.batches import Batches
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.errors import ModelError, TrialError, UnknownNameError
from trueup.recording import Channel
from trueup.trial import Observed, Reference, Trial

Array = NDArray[np.float64]
STEP = 0.002
STONE = """<mujoco><option timestep="0.002" integrator="Euler" gravity="0 0 {gravity}"/><worldbody>
  <body name="stone" pos="0 0 2"><freejoint/><inertial pos="0 0 0" mass="2" diaginertia=".1 .1 .1"/></body>
</worldbody></mujoco>"""
CART = """<mujoco><option timestep="0.002"/><worldbody><body name="cart"><joint name="x" type="slide" axis="1 0 0"/>
  <inertial pos="0 0 0" mass="2" diaginertia=".1 .1 .1"/><site name="s"/></body></worldbody>
  <actuator><motor name="push" joint="x"/></actuator>
  <sensor><framepos name="place" objtype="site" objname="s"/></sensor></mujoco>"""


def stone(tmp_path: Path, gravity: float = -9.81) -> MujocoSimulator:
    (tmp_path / "stone.xml").write_text(STONE.format(gravity=gravity))
    model = load(tmp_path / "stone.xml")
    return MujocoSimulator(model, *declare(model, [Declaration("mass", ("stone",))]), step=STEP)


def cart(tmp_path: Path) -> MujocoSimulator:
    (tmp_path / "cart.xml").write_text(CART)
    model = load(tmp_path / "cart.xml")
    return MujocoSimulator(model, *declare(model, [Declaration("damping", ("x",))]), step=STEP)


def falling(duration: float = 1.0, **more: object) -> Trial:
    time = np.linspace(0.0, duration, round(100 * duration) + 1)
    start = {
        "base_position": Channel("base_position", ("x", "y", "z"), "m", np.zeros(1), np.array([[0.0, 0.0, 2.0]])),
        "base_orientation": Channel("base_orientation", ("roll", "pitch", "yaw"), "rad", np.zeros(1), np.zeros((1, 3))),
    }
    observed = {"base_position": Observed(("x", "y", "z"), "m", time)}
    return Trial("fall", 0.0, duration, None, observed, start, **more)  # type: ignore[arg-type]


def riding(name: str = "ride", duration: float = 1.0, speed: float = 0.0, **more: object) -> Trial:
    time = np.linspace(0.0, duration, round(100 * duration) + 1)
    start = {
        "position": Channel("position", ("x",), "m", np.zeros(1), np.zeros((1, 1))),
        "velocity": Channel("velocity", ("x",), "m/s", np.zeros(1), np.full((1, 1), speed)),
    }
    observed = {"position": Observed(("x",), "m", time)}
    return Trial(name, 0.0, duration, None, observed, start, **more)  # type: ignore[arg-type]


class Force:
    """A constant force for each copy, which remembers what it saw."""

    period = 0.01

    def __init__(self, values: Array, force: float = 0.0) -> None:
        self.values, self.force = values, force
        self.seen: list[Observation] = []
        self.places: list[Array] = []
        self.sensed: list[Array] = []

    def reset(self, observation: Observation) -> None:
        self.trial = observation.trial

    def command(self, observation: Observation) -> Array:
        self.seen.append(observation)
        self.places.append(observation.position[:, 0].copy())
        self.sensed.append(observation.sensors["place"][:, 0].copy())
        trial = observation.trial
        wanted = trial.references["force"].values[0, 0] if trial and "force" in trial.references else self.force
        return np.full((len(self.values), 1), wanted)


def reference(force: float) -> dict[str, Reference]:
    return {"force": Reference(("force",), ("N",), np.array([[force]]))}


def no_damping(rows: int = 3) -> Array:
    return np.zeros((rows, 1))


def test_each_trial_has_its_own_controller_which_knows_it(tmp_path: Path) -> None:
    made: list[Force] = []

    def factory(values: Array) -> Force:
        made.append(Force(values))
        return made[-1]

    trials = [
        riding("a", 1.0, references=reference(2.0)),
        riding("b", 0.5, references=reference(-4.0)),
        riding("c", 0.7, controller=lambda values: Force(values, 6.0)),
    ]
    a, b, c = cart(tmp_path).rollout(trials, no_damping(), factory)
    assert [m.trial for m in made] == trials[:2]
    assert all(m.values.shape == (3, 0) and len(o.position) == 3 for m in made for o in m.seen)
    assert all(o.trial is m.trial for m in made for o in m.seen)
    for rollout, force in ((a, 2.0), (b, -4.0), (c, 6.0)):
        time = rollout.trial.observed["position"].time
        assert np.allclose(rollout.channels["position"][:, :, 0], 0.5 * force / 2.0 * time**2, atol=8e-3)


class Spring:
    """Pulls to the middle, as it sees the cart; keeps which threads asked it."""

    period = 0.01

    def __init__(self, values: Array) -> None:
        self.threads: set[int] = set()

    def reset(self, observation: Observation) -> None:
        pass

    def command(self, observation: Observation) -> Array:
        self.threads.add(threading.get_ident())
        return -50.0 * observation.sensors["place"][:, :1] - 2.0 * observation.velocity


def test_trials_stepped_while_others_are_controlled_end_as_they_do_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulator, made, begun = cart(tmp_path), list[Spring](), list[int]()
    moves = [riding(f"{k}", 0.4 + 0.1 * k, 0.5 + k, sensing=(Sensing("position", latency=0.015),)) for k in range(5)]
    trials = [replace(t, controller=lambda values: made.append(Spring(values)) or made[-1]) for t in moves]
    monkeypatch.setattr(Batches, "side_by_side", lambda *_: begun.append(1) or 3)
    together = simulator.rollout(trials, no_damping(4))
    assert begun
    assert len(made) == 5
    assert {t for m in made for t in m.threads} == {threading.get_ident()}
    for rollout, trial in zip(together, trials, strict=True):
        (alone,) = simulator.rollout([trial], no_damping(4))
        assert rollout.trial is trial
        assert np.array_equal(rollout.channels["position"], alone.channels["position"])
        assert np.ptp(alone.channels["position"]) > 0.03


def test_a_trial_with_a_controller_and_one_with_a_command_run_side_by_side(tmp_path: Path) -> None:
    simulator = cart(tmp_path)
    command = Channel("command", ("x",), "N", np.array([0.0, 0.3]), np.array([[1.0], [-1.0]]))
    played, own = (
        replace(riding("played"), command=command),
        riding("own", controller=lambda values: Force(values, 3.0)),
    )
    values = np.array([[0.0], [0.5]])
    together = simulator.rollout([played, own], values)
    for rollout, trial in zip(together, (played, own), strict=True):
        (alone,) = simulator.rollout([trial], values)
        assert np.array_equal(rollout.channels["position"], alone.channels["position"])


def test_a_controller_sees_the_present_state_and_sensors_only_where_it_looks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[Force] = []
    trial = riding(speed=1.0, controller=lambda values: seen.append(Force(values)) or seen[-1])  # type: ignore[func-returns-value]
    simulator = cart(tmp_path)
    simulator.rollout([trial], no_damping())
    times = np.array([o.time for o in seen[0].seen])
    assert np.allclose(np.array(seen[0].places)[:, 0], times, atol=1e-9)
    assert np.allclose(np.array(seen[0].sensed)[:, 0], times, atol=1e-9)
    calls = counted(monkeypatch)

    class Blind(Force):
        def command(self, observation: Observation) -> Array:
            return np.zeros((len(self.values), 1))

    simulator.rollout([replace(trial, controller=Blind)], no_damping())
    assert calls["forward"] == 0


def test_a_fall_ends_a_run_when_the_law_says(tmp_path: Path) -> None:
    trial = falling(ends=(Fallen(height=1.0),))
    (rollout,) = stone(tmp_path).rollout([trial], np.array([[2.0], [3.0]]))
    lowest = np.sqrt(2.0 * 1.0 / 9.81)
    assert sorted(rollout.ends) == [0, 1]
    assert rollout.failures == {}
    for end in rollout.ends.values():
        assert end.name == "fallen"
        assert lowest <= end.at <= lowest + LOOK + 2 * STEP
    heights = rollout.channels["base_position"][0, :, 2]
    lasted = trial.observed["base_position"].time <= rollout.ends[0].at
    assert np.allclose(heights[lasted], 2.0 - 0.5 * 9.81 * trial.observed["base_position"].time[lasted] ** 2, atol=0.01)
    assert np.isnan(heights[~lasted]).all()
    recording = rollout.recording(1)
    assert recording.stop <= rollout.ends[1].at
    assert ended(recording) == rollout.ends[1]


def test_a_tilt_ends_a_run_and_a_row_that_ends_leaves_the_others_alone(tmp_path: Path) -> None:
    """Turned about its own axis by a torque that acts on all, the lighter rows turn no faster: only their starts differ."""
    simulator, values = stone(tmp_path, gravity=0.0), np.full((4, 1), 2.0)
    scatter = StartScatter("base_orientation", 0.5)
    trial = falling(disturbances=(scatter,), ends=(Fallen(tilt=0.5),)).seeded(np.random.default_rng(3))
    (whole,) = simulator.rollout([replace(trial, ends=())], values)
    (rollout,) = simulator.rollout([trial], values)
    assert 0 < len(rollout.ends) < 4
    assert all(end.at == 0.0 for end in rollout.ends.values())
    left = [row for row in range(4) if row not in rollout.ends]
    assert np.array_equal(rollout.channels["base_position"][left], whole.channels["base_position"][left])


@pytest.mark.parametrize(
    ("ends", "name"),
    [
        ((Left("position", {"x": (-1.0, 0.5)}), Arrived("position", {"x": 2.0}, 0.1)), "left the area"),
        ((Left("position", {"x": (-1.0, 9.0)}), Arrived("position", {"x": 0.6}, 0.1)), "arrived"),
        ((When("fast enough", lambda seen: seen.position[:, 0] > 0.5),), "fast enough"),
        ((When("there", lambda seen: seen.sensors["place"][:, 0] > 0.5),), "there"),
    ],
)
def test_a_run_ends_by_whichever_condition_holds_first(tmp_path: Path, ends: tuple[When, ...], name: str) -> None:
    (rollout,) = cart(tmp_path).rollout([riding(speed=1.0, ends=ends)], no_damping(2))
    for end in rollout.ends.values():
        assert end.name == name
        assert 0.5 <= end.at <= 0.5 + LOOK + 2 * STEP
    assert len(rollout.ends) == 2


@pytest.mark.parametrize("step", [0.002, 0.003, 0.0007])
def test_no_look_is_missed_whatever_the_step(tmp_path: Path, step: float) -> None:
    def after(when: float) -> When:
        return When("late", lambda seen: np.full(len(seen.position), seen.time >= when))

    instants = np.arange(0.0, 0.9, 0.02) + 1e-6
    trials = [riding(f"{when}", ends=(after(when),)) for when in instants]
    done = cart(tmp_path).at_step(step).rollout(trials, no_damping(1))
    late = np.array([r.ends[0].at for r in done]) - instants
    assert (late > 0.0).all()
    assert late.max() <= LOOK + step


def counted(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """Counts the steps that rows are really stepped, and calls of forward."""
    count = {"steps": 0, "forward": 0}
    batch = mujoco.batch.Batch
    rollout, step, forward = batch.rollout, batch.step, batch.forward

    def rolled(self: object, nstep: int, *args: object, **named: object) -> object:
        count["steps"] += nstep * len(named["ids"])  # type: ignore[arg-type]
        return rollout(self, nstep, *args, **named)  # type: ignore[arg-type]

    def stepped(self: mujoco.batch.Batch, ids: Array | None = None, *args: object) -> None:
        count["steps"] += self.nsim if ids is None else len(ids)
        step(self, ids, *args)  # type: ignore[arg-type]

    def forwarded(self: object, *args: object, **named: object) -> None:
        count["forward"] += 1
        forward(self, *args, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(batch, "rollout", rolled)
    monkeypatch.setattr(batch, "step", stepped)
    monkeypatch.setattr(batch, "forward", forwarded)
    return count


@pytest.mark.parametrize("live", [False, True])
@pytest.mark.parametrize("closed", [False, True])
def test_rows_that_ended_are_stepped_no_further(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, live: bool, closed: bool
) -> None:
    (tmp_path / "cart.xml").write_text(CART)
    model = load(tmp_path / "cart.xml")
    lines = [Declaration("damping", ("x",))] + ([Declaration("friction_static", ("x",))] if live else [])
    simulator = MujocoSimulator(model, *declare(model, lines), step=STEP)
    values = np.repeat(simulator.parameters.nominal[None], 10, axis=0) * 0.0
    values[5:, 0] = 50.0  # these are held back and never arrive
    trial = riding(duration=4.0, speed=1.0, ends=(Arrived("position", {"x": 0.4}, 0.05),))
    count = counted(monkeypatch)
    (rollout,) = simulator.rollout([trial], values, Force if closed else None)
    assert sorted(rollout.ends) == [0, 1, 2, 3, 4]
    whole, until = 4.0 / STEP, 0.4 / STEP
    wasted = count["steps"] / (5 * whole + 5 * until) - 1.0
    assert wasted < 0.05


def test_a_row_that_fails_is_stepped_no_further(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    count = counted(monkeypatch)
    (rollout,) = cart(tmp_path).rollout([riding(duration=4.0, speed=1.0)], np.array([[0.0], [np.nan]]))
    assert list(rollout.failures) == [1]
    assert count["steps"] < 1.2 * 4.0 / STEP


def test_between_two_commands_the_engine_is_called_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    rollout = mujoco.batch.Batch.rollout
    monkeypatch.setattr(
        mujoco.batch.Batch, "rollout", lambda self, n, *a, **k: calls.append(n) or rollout(self, n, *a, **k)
    )
    cart(tmp_path).rollout([riding(duration=1.0)], no_damping(), Force)
    assert sum(calls) >= 1.0 / STEP
    assert len(calls) <= 1.0 / Force.period + 4


def test_a_push_changes_momentum_by_force_times_time(tmp_path: Path) -> None:
    push = Push("stone", (10.0, 30.0), (0.2, 0.5), (0.1, 0.2))
    trial = falling(disturbances=(push,)).seeded(np.random.default_rng(0))
    values = np.array([[2.0], [2.0], [4.0]])
    (rollout,) = stone(tmp_path, gravity=0.0).rollout([trial], values)
    place = rollout.channels["base_position"]
    speed = (place[:, -1] - place[:, -3]) / 0.02
    drawn = trial.settled().streams("fall/0", 3)
    start, lasting, size = drawn.uniform(0.2, 0.5), drawn.uniform(0.1, 0.2), drawn.uniform(10.0, 30.0)
    assert np.allclose(np.linalg.norm(speed, axis=1), size * lasting / values[:, 0], rtol=0.05)
    assert np.allclose(speed[:, 2], 0.0, atol=1e-9)
    before = trial.observed["base_position"].time < start.min() - 0.02
    assert np.array_equal(place[0, before], place[1, before])


def test_starts_scatter_and_commands_are_noisy_as_much_as_declared(tmp_path: Path) -> None:
    rows = 400
    scattered = riding(disturbances=(StartScatter("position", 0.1), StartScatter("velocity", 0.2)))
    (rollout,) = cart(tmp_path).rollout([scattered.seeded(np.random.default_rng(1))], no_damping(rows))
    place = rollout.channels["position"][:, :, 0]
    assert np.std(place[:, 0]) == pytest.approx(0.1, rel=0.1)
    assert np.std(place[:, -1] - place[:, 0]) == pytest.approx(0.2, rel=0.1)
    noisy = riding(disturbances=(CommandNoise(4.0, every=0.05),)).seeded(np.random.default_rng(1))
    (rollout,) = cart(tmp_path).rollout([noisy], no_damping(rows))
    place = rollout.channels["position"][:, :, 0]
    # The speed after n draws: n independent changes of force / mass * 0.05 s.
    speed = (place[:, -1] - place[:, -2]) / 0.01
    assert np.std(speed) == pytest.approx(4.0 / 2.0 * 0.05 * np.sqrt(20.0), rel=0.1)


@pytest.mark.parametrize("latency", [0.005, 0.013, 0.1])
def test_a_late_sensor_is_late_for_the_controller_and_in_what_is_read_off(tmp_path: Path, latency: float) -> None:
    seen: list[Force] = []

    def factory(values: Array) -> Force:
        seen.append(Force(values))
        return seen[-1]

    sensing = (Sensing("position", latency=latency), Sensing("place", latency=latency))
    trial = riding(speed=1.0, sensing=sensing)
    (rollout,) = cart(tmp_path).rollout([trial], no_damping(), factory)
    times = np.array([o.time for o in seen[0].seen])
    assert np.allclose(np.array(seen[0].places)[:, 1], np.maximum(times - latency, 0.0), atol=1e-9)
    assert np.allclose(np.array(seen[0].sensed)[:, 1], np.maximum(times - latency, 0.0), atol=1e-9)
    read = rollout.channels["position"][1, :, 0]
    assert np.allclose(read, np.maximum(trial.observed["position"].time - latency, 0.0), atol=1e-9)


def test_noise_of_sensors_is_as_large_as_declared_and_moves_nothing(tmp_path: Path) -> None:
    seen: list[Force] = []
    trial = riding(
        sensing=(Sensing("position", 0.3), Sensing("place", 0.2)),
        controller=lambda values: seen.append(Force(values)) or seen[-1],  # type: ignore[func-returns-value]
        ends=(Left("position", {"x": (-0.01, 0.01)}),),
    ).seeded(np.random.default_rng(0))
    (rollout,) = cart(tmp_path).rollout([trial], no_damping(50))
    assert np.std(np.array(seen[0].places)) == pytest.approx(0.3, rel=0.05)
    assert np.std(np.array(seen[0].sensed)) == pytest.approx(0.2, rel=0.05)
    assert np.std(rollout.channels["position"]) == pytest.approx(0.3, rel=0.05)
    assert rollout.ends == {}


@pytest.mark.parametrize(
    ("what", "words"),
    [
        (Push("ston", (1.0, 1.0), (0.0, 0.0), (1.0, 1.0)), "body 'ston'"),
        (StartScatter("height", 1.0), "channel 'height'"),
    ],
)
def test_what_chance_cannot_act_on_is_named(tmp_path: Path, what: Disturbance, words: str) -> None:
    trial = falling(disturbances=(what,)).seeded(np.random.default_rng(0))
    with pytest.raises(UnknownNameError, match=words):
        stone(tmp_path).rollout([trial], np.full((1, 1), 2.0))


def test_an_end_on_a_channel_that_is_not_there_and_chance_without_a_seed_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="end 'arrived' of trial 'ride' looks at 'base_height'"):
        cart(tmp_path).rollout([riding(ends=(Arrived("base_height", {"h": 1.0}, 0.1),))], no_damping())
    with pytest.raises(TrialError, match=r"trial 'ride' declares CommandNoise, .* trial.seeded"):
        cart(tmp_path).rollout([riding(disturbances=(CommandNoise(1.0),))], no_damping())


def test_a_buffeted_body_gains_the_impulse_of_its_wandering_force(tmp_path: Path) -> None:
    buffeting = Buffeting("stone", 3.0, memory=0.15, every=0.1)
    trial = falling(1.0, disturbances=(buffeting,)).seeded(np.random.default_rng(5))
    (run,) = stone(tmp_path, gravity=0.0).rollout([trial], np.full((4, 1), 2.0))
    forces = buffeting.forces(1.0, trial.settled().streams("fall/0", 4))[:, :10]
    speed = np.concatenate([np.zeros((4, 1, 2)), 0.1 * np.cumsum(forces, axis=1) / 2.0], axis=1)
    gone = np.sum(0.5 * (speed[:, 1:] + speed[:, :-1]) * 0.1, axis=1)  # of a force that is constant for 0.1 s
    assert run.channels["base_position"][:, -1, :2] == pytest.approx(gone, rel=0.01, abs=1e-3)
    assert run.channels["base_position"][:, -1, 2] == pytest.approx(2.0, abs=1e-9)
    many = buffeting.forces(200.0, Chance(1).streams("many", 5))
    assert many.std() == pytest.approx(3.0, rel=0.05)
    assert np.mean(many[:, 1:] * many[:, :-1]) / 9.0 == pytest.approx(np.exp(-0.1 / 0.15), abs=0.05)


def test_a_sensor_that_is_late_shows_the_past_and_one_that_is_off_stays_off(tmp_path: Path) -> None:
    made: list[Force] = []

    def factory(values: Array) -> Force:
        made.append(Force(values, 2.0))
        return made[-1]

    simulator = cart(tmp_path)
    for sensing in (Sensing("place", latency=0.05), Sensing("place", latency=0.05, bias=0.3)):
        simulator.rollout([riding(sensing=(sensing,)).seeded(np.random.default_rng(3))], no_damping(), factory)
    late, off = (np.array(m.sensed) for m in made)
    time = np.array([o.time for o in made[0].seen])
    assert late == pytest.approx(np.tile(0.5 * np.maximum(time - 0.05, 0.0)[:, None] ** 2, (1, 3)), abs=5e-3)
    away = off - late
    assert away == pytest.approx(np.repeat(away[:1], len(away), axis=0), abs=1e-9)
    assert np.ptp(away[0]) > 0.05
    assert np.abs(away).max() < 1.5


def test_commands_that_are_known_ahead_do_what_they_do_when_they_are_asked_for(tmp_path: Path) -> None:
    file = tmp_path / "cart.xml"
    file.write_text(CART)
    model = load(file)
    simulator = MujocoSimulator(
        model, *declare(model, [Declaration("damping", ("x",)), Declaration("delay", ("push",))])
    )
    command = Channel("command", ("x",), "N", np.arange(40) / 50.0, np.random.default_rng(0).standard_normal((40, 1)))
    asked: list[float] = []

    class Asked:
        """The same, without a word of what comes."""

        def __init__(self, copies: int) -> None:
            self._played, self.period = Playback(command, copies, period=0.006), 0.006

        def reset(self, observation: Observation) -> None:
            self._played.reset(observation)

        def command(self, observation: Observation) -> Array:
            asked.append(observation.time)
            return self._played.command(observation)

    values = np.array([[0.1, 0.0], [0.3, 0.013], [0.2, 0.05]])
    trials = [riding("long", 0.9, ends=(Left("position", {"x": (-0.02, 0.02)}),)), riding("short", 0.31)]
    told = simulator.rollout(trials, values, lambda v: Playback(command, len(v), period=0.006))
    alone = simulator.rollout(trials, values, lambda v: Asked(len(v)))
    assert len(asked) > 100
    for a, b in zip(told, alone, strict=True):
        assert np.array_equal(a.channels["position"], b.channels["position"], equal_nan=True)
        assert a.ends == b.ends
