# SPDX-License-Identifier: Apache-2.0
"""Batches of MuJoCo simulations: rows do not see one another, failures stay where they are, names are checked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.articulated.declarations import Declaration, declare
from trueup.articulated.signals import Signals
from trueup.controllers.playback import Playback
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.errors import UnknownNameError
from trueup.loop.condensing import cut
from trueup.recording import Channel, Recording
from trueup.studies.servo_arm.demo import model_path, motions
from trueup.testing import check_simulator
from trueup.trial import Trial

Array = NDArray[np.float64]
JOINTS = ("base", "shoulder", "elbow", "wrist")
LINES = [Declaration("kp"), Declaration("friction", tie="all"), Declaration("delay", tie="all")]


def simulator(lines: list[Declaration], **options: object) -> MujocoSimulator:
    model = load(model_path())
    return MujocoSimulator(model, *declare(model, lines), **options)  # type: ignore[arg-type]


def recording(name: str = "r", duration: float = 2.0) -> Recording:
    command = motions(4)["multisine"][20 : 20 + round(50 * duration)]
    time = 0.02 * np.arange(len(command), dtype=np.float64)
    channels = {n: Channel(n, JOINTS, "rad", time, command) for n in ("command", "position")}
    return Recording(name, channels)


def positions(made: MujocoSimulator, values: Array, *recordings: Recording) -> list[Array]:
    return [r.channels["position"] for r in made.rollout([Trial.of(r) for r in recordings], values)]


@pytest.mark.parametrize("more", [[], [Declaration("dead_band", tie="all"), Declaration("friction_static", tie="all")]])
def test_the_simulator_keeps_its_contract(more: list[Declaration]) -> None:
    check_simulator(simulator([*LINES, *more]), recording())


def test_a_frozen_parameter_is_still_applied() -> None:
    free = simulator([Declaration("kp", tie="all", nominal=5.0)])
    frozen = simulator([Declaration("kp", tie="all", nominal=5.0, frozen=True), Declaration("damping", tie="all")])
    other = simulator([Declaration("damping", tie="all")])
    soft, applied, hard = (positions(s, s.parameters.nominal[None], recording())[0] for s in (free, frozen, other))
    assert np.array_equal(soft, applied)
    assert np.abs(soft - hard).max() > 0.01


def test_a_name_that_does_not_exist_lists_those_that_do() -> None:
    model = load(model_path())
    with pytest.raises(UnknownNameError, match=r"joint 'elbw' is not in .*'elbow'.*base, elbow, shoulder, wrist"):
        declare(model, [Declaration("damping", ("elbw",))])
    with pytest.raises(UnknownNameError, match=r"quantity 'dampng' .*'damping'.*armature"):
        declare(model, [Declaration("dampng")])


def test_failed_simulations_are_reported_by_row_and_leave_their_neighbours_alone() -> None:
    made = simulator([Declaration("kp", tie="all"), Declaration("mass", ("hand",))])
    good = np.array([[10.0, 0.09], [14.0, 0.12], [8.0, 0.10]])
    bad = np.array([np.nan, np.nan])
    mixed = np.stack([good[0], bad, good[1], [1e12, -50.0], good[2]])
    (rollout,) = made.rollout([Trial.of(recording())], mixed)
    (alone,) = made.rollout([Trial.of(recording())], good)
    assert sorted(rollout.failures) == [1, 3]
    assert all(rollout.failures.values())
    assert np.isnan(rollout.channels["position"][1]).all()  # it never began
    assert np.isfinite(rollout.channels["position"][3, 0]).all()  # what it showed before it blew up stays
    assert np.isnan(rollout.channels["position"][3, 1:]).all()
    assert np.array_equal(rollout.channels["position"][[0, 2, 4]], alone.channels["position"])
    assert alone.failures == {}


def test_an_unstable_simulation_leaves_no_file_in_the_folder_it_was_started_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    made = simulator([Declaration("kp", tie="all"), Declaration("mass", ("hand",))])
    (rollout,) = made.rollout([Trial.of(recording())], np.array([[10.0, 0.09], [1e12, -50.0]]))
    assert sorted(rollout.failures) == [1]
    assert not list(tmp_path.iterdir())


def test_recordings_of_different_lengths_in_one_call_equal_separate_calls() -> None:
    made = simulator(LINES)
    values = made.parameters.from_unit(np.random.default_rng(1).uniform(0.3, 0.7, (3, int(made.parameters.free.sum()))))
    several = [recording("short", 0.7), recording("long", 3.0), recording("middle", 1.9)]
    together = positions(made, values, *several)
    for one, found in zip(several, together, strict=True):
        assert np.array_equal(positions(made, values, one)[0], found)


def test_the_lockstep_path_agrees_with_the_fast_one_where_the_live_quantity_is_zero() -> None:
    fast, slow = simulator(LINES), simulator([*LINES, Declaration("dead_band", tie="all")])
    a = positions(fast, fast.parameters.nominal[None], recording())[0]
    b = positions(slow, slow.parameters.nominal[None], recording())[0]
    assert np.abs(a - b).max() < 1e-9


def test_a_controller_that_plays_the_command_back_equals_the_command() -> None:
    made, r = simulator([Declaration("kp", tie="all")]), recording()
    values = np.array([[9.0], [12.0]])
    (own,) = made.rollout([Trial.of(r)], values, lambda v: Playback(r.channel("command"), len(v), period=0.02))
    assert np.abs(own.channels["position"] - positions(made, values, r)[0]).max() < 1e-9


def test_a_sensor_bias_shifts_what_is_seen_and_not_what_happens() -> None:
    made = simulator([Declaration("bias", ("wrist",))])
    straight, shifted = positions(made, np.array([[0.0], [0.05]]), recording())[0]
    # Both start where the sensor says: the biased one in truth lower, then both follow the same command.
    assert shifted[-1, 3] - straight[-1, 3] == pytest.approx(0.05, abs=5e-3)
    assert np.abs(shifted[:, :3] - straight[:, :3]).max() < 0.02


def test_a_model_with_missing_meshes_loads_and_says_so(tmp_path: Path) -> None:
    (tmp_path / "m.xml").write_text(
        '<mujoco><asset><mesh name="m" file="gone.stl"/></asset><worldbody><body name="b"><joint name="j"/>'
        '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
    )
    assert "1 meshes could not be found" in load(tmp_path / "m.xml").notes[0]


def test_windows_of_a_long_recording_keep_only_the_commands_that_act_in_them(monkeypatch: pytest.MonkeyPatch) -> None:
    made, log = simulator(LINES), recording(duration=20.0)
    values = np.tile(made.parameters.nominal, (3, 1))
    values[:, made.parameters.names.index("delay")] = 0.0, 0.033, 0.15
    whole = Trial.of(log)
    windows = [replace(cut(whole, start, 0.4), name=f"{start}") for start in np.arange(0.0, whole.duration - 0.5, 0.4)]
    told = Signals(made.model, made.quantities, windows, values)
    kept = [len(told.held(k, "shoulder")[0]) for k in range(len(windows))]
    assert whole.duration > 8.0
    assert max(kept) < 50.0 * 3.0
    near = [r.channels["position"] for r in made.rollout(windows, values)]
    monkeypatch.setattr("trueup.engines.mujoco.rollout._ROWS", 7)
    parts = [r.channels["position"] for r in made.rollout(windows, values)]
    monkeypatch.setattr("trueup.articulated.signals.SETTLE", 0.0)  # shorter than the delays: all are kept
    every = [r.channels["position"] for r in made.rollout(windows, values)]
    assert all(np.array_equal(a, b) for a, b in zip(near, parts, strict=True))
    assert max(float(np.abs(a - b).max()) for a, b in zip(near, every, strict=True)) < 1e-9
