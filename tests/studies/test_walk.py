# SPDX-License-Identifier: Apache-2.0
"""The stand-in NAO and the SimSpark-like simulator: as published, different, and both walked by the start walk."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.controllers.walk_engine.requests import REQUESTS, requests
from trueup.ends import ended
from trueup.engines.mujoco.model import load
from trueup.errors import UnknownNameError
from trueup.recording import Channel, Recording
from trueup.studies.walk.robot import StandInNao, Truth
from trueup.studies.walk.scenes import MOTORS, NAO, SIMSPARK, simulator, task
from trueup.tasks.omni_walk import OmniWalk
from trueup.tasks.task import robot_trials
from trueup.tasks.walking import WalkFront

Array = NDArray[np.float64]


def ahead(recording: Recording) -> float:
    x = recording.channel("base_position").column("x")
    return float(x[-1] - x[0])


def truth(seed: int) -> Truth:
    return Truth.random(np.random.default_rng([seed, 2012]))


def test_the_nao_weighs_and_stands_as_published() -> None:
    m = load(NAO).compiled
    assert m.body_mass.sum() == pytest.approx(5.305, abs=0.001)  # V5 with its placeholder links: 5.305 kg
    leg = sum(m.body(f"L_{n}").mass[0] for n in ("pelvis", "hip", "thigh", "tibia", "ankle", "foot"))
    assert leg == pytest.approx(1.207, abs=0.001)
    data = mujoco.MjData(m)
    mujoco.mj_kinematics(m, data)
    hip, sole = data.joint("LHipPitch").xanchor[2], data.geom("L_mid_out").xpos[2] - 0.012
    assert hip - sole == pytest.approx(0.100 + 0.1029 + 0.04519, abs=1e-6)
    assert {m.actuator(i).name for i in range(m.nu)} >= set(MOTORS)
    assert "RHipYawPitch" not in MOTORS


def test_the_simulators_robot_is_another_one_than_the_robot() -> None:
    nao, other = load(NAO).compiled, load(SIMSPARK).compiled
    assert other.body_mass.sum() == pytest.approx(4.607, abs=0.001)
    lengths = []
    for m in (nao, other):
        data = mujoco.MjData(m)
        mujoco.mj_kinematics(m, data)
        hip, knee, ankle = (data.joint(f"L{n}").xanchor[2] for n in ("HipPitch", "KneePitch", "AnklePitch"))
        lengths.append((hip - knee, knee - ankle))
    assert lengths[0] == pytest.approx((0.100, 0.1029))
    assert lengths[1] == pytest.approx((0.120, 0.100))
    assert np.all(other.dof_frictionloss == 0.0)
    assert nao.dof_frictionloss[-1] > 0.0
    assert other.actuator_forcerange[-1, 1] > 2.0 * nao.actuator_forcerange[-2, 1]


@pytest.mark.parametrize("path", [NAO, SIMSPARK], ids=["nao", "simspark"])
def test_both_models_stand_still_in_their_standing_pose(path) -> None:
    model = load(path).compiled
    model.opt.timestep = 0.005
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    for _ in range(400):
        mujoco.mj_step(model, data)
    assert np.abs(data.qvel).max() < 0.01
    assert data.qpos[:3] == pytest.approx(model.key_qpos[0, :3], abs=0.003)


def test_one_motor_turns_both_hip_yaw_pitch_joints() -> None:
    model = load(NAO).compiled
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.ctrl[model.actuator("LHipYawPitch").id] = -0.2
    for _ in range(400):
        mujoco.mj_step(model, data)
    left, right = data.joint("LHipYawPitch").qpos[0], data.joint("RHipYawPitch").qpos[0]
    assert left < -0.08
    assert left == pytest.approx(right, abs=0.02)


def test_the_start_walk_walks_on_stand_ins_and_in_the_simulator() -> None:
    for noisy, falls in ((False, 0), (True, 3)):  # with noise it falls in one of ten runs
        walk = task(WalkFront, runs=1, seconds=10.0, noisy=noisy)
        values = np.tile(walk.parameters.nominal, (12, 1))
        (done,) = simulator(threads=1).rollout(walk.trials, values, walk.controllers)
        assert len(done.ends) <= falls
        assert 0.08 < np.mean(np.delete(walk.made_good(done), list(done.ends))) < 0.14
    walk = task(WalkFront, runs=1, seconds=10.0)
    for seed in (0, 1):
        robot = StandInNao(truth(seed), seed=seed, threads=1, log=0.0)
        runs = robot.perform(replace(walk.trials[0], repeats=6))
        assert not any(ended(r) for r in runs)
        speeds = [ahead(r) / 10.0 for r in runs]
        assert 0.10 < np.mean(speeds) < 0.14
        assert np.std(speeds) > 1e-4  # no run is quite like another


def test_a_stand_in_repeats_itself_by_name_and_replays_what_it_was_commanded() -> None:
    walk = task(WalkFront, runs=1, seconds=4.0)
    robot = StandInNao(truth(0), threads=1)
    (trial,) = robot_trials(walk, walk.parameters.nominal)
    (first,), (again,) = robot.perform(trial), robot.perform(trial)
    assert np.array_equal(first.channel("position").values, again.channel("position").values)
    (other,) = robot.perform(replace(trial, name="another run"))
    assert not np.allclose(first.channel("position").values, other.channel("position").values, atol=1e-3)
    command = first.channel("command")
    (replayed,) = robot.perform(replace(trial, name="replay", command=command, settings={}))
    assert replayed.channel("command").values == pytest.approx(command.at(replayed.channel("command").time, hold=True))
    assert first.channel("gyro").values.std() > 0.05


def test_motors_lag_their_commands_by_the_hidden_latency() -> None:
    hidden = truth(0)
    robot = StandInNao(hidden, threads=1, log=1000.0)
    time = np.array([0.0, 1.0])
    stand = load(NAO).compiled.key_ctrl[0]
    columns = [load(NAO).columns()[m] for m in MOTORS]
    rows = np.stack([stand[columns], stand[columns]])
    rows[1, MOTORS.index("LKneePitch")] += 0.2
    trial = replace(
        task(WalkFront, runs=1, seconds=2.0).trials[0], command=Channel("command", MOTORS, "rad", time, rows)
    )
    (run,) = robot.perform(trial)
    knee = run.channel("position")
    moved = np.abs(knee.column("LKneePitch") - knee.column("LKneePitch")[knee.time < 1.0][-1])
    begun = knee.time[(moved > 0.003) & (knee.time > 1.0)][0] - 1.0
    assert hidden.values["delay"] * 0.9 < begun < hidden.values["delay"] + 0.03


def test_a_stand_in_names_what_is_no_setting_of_its_walk() -> None:
    walk = task(WalkFront, runs=1)
    with pytest.raises(UnknownNameError, match="stepLength"):
        StandInNao(truth(0)).perform(replace(walk.trials[0], settings={"stepLength": 1.0}))


def test_the_walk_goes_where_it_is_asked_to() -> None:
    walk, sides = (
        task(WalkFront, runs=1, seconds=8.0, noisy=False),
        ((0.0, 0.67, 0.0), (0.0, 0.0, 0.67), (0.0, 0.0, -0.67)),
    )
    trials = [
        replace(walk.trials[0], name=f"{k}", references={REQUESTS: requests(np.array([[0.0, *asked]]))})
        for k, asked in enumerate(sides)
    ]
    done = simulator(threads=1).rollout(trials, walk.parameters.nominal[None], walk.controllers)
    assert not any(r.ends for r in done)
    place, yaw = (
        np.array([r.channels[n][0, -1, k] for r in done]) for n, k in (("base_position", 1), ("base_orientation", 2))
    )
    assert place[0] > 0.15
    assert abs(yaw[0]) < 0.5
    assert np.unwrap(done[1].channels["base_orientation"][0, :, 2])[-1] > 1.5
    assert np.unwrap(done[2].channels["base_orientation"][0, :, 2])[-1] < -1.5


def test_the_walk_goes_through_its_course_in_the_simulator() -> None:
    walk = task(OmniWalk, runs=1, noisy=False, stretch=0.5)
    done = simulator(threads=1).rollout(walk.trials, walk.parameters.nominal[None], walk.controllers)
    assert not done[0].ends
    assert -walk.score(done)[0] > 0.5
