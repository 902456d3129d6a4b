# SPDX-License-Identifier: Apache-2.0
"""The walk's legs go where they are told, both sides alike, and its feet clear the ground."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from trueup.controllers.controller import Observation
from trueup.controllers.walk_engine.attitude import Complementary
from trueup.controllers.walk_engine.engine import PARAMETERS, WalkEngine
from trueup.controllers.walk_engine.requests import REQUESTS, TARGETS, OfTrial, requests, targets
from trueup.engines.mujoco.biped import biped_of, inertial
from trueup.engines.mujoco.model import Model, load
from trueup.errors import ModelError, ParameterError, TrialError, UnknownNameError
from trueup.studies.walk.scenes import LEFT, NAO, RIGHT, SIMSPARK, biped
from trueup.trial import Reference, Trial

Array = NDArray[np.float64]


def going(reference: dict[str, Reference]) -> Trial:
    return Trial("walk", 0.0, 10.0, None, {}, references=reference)


def seen(model: Model, time: float, trial: Trial, rows: int = 1, **sensors: Array) -> Observation:
    still = {"gyro": np.zeros((rows, 3)), "accelerometer": np.tile([0.0, 0.0, 9.81], (rows, 1)), **sensors}
    position = np.tile(model.compiled.key_qpos[0], (rows, 1))
    return Observation(time, position, np.zeros((rows, model.compiled.nv)), still, trial)


def walked(model: Model, seconds: float, values: Array, **request: float) -> Array:
    """(T, b, nu) what an upright robot is commanded every 10 ms while it is asked for the same all the time."""
    row = [0.0, *(request.get(k, 0.0) for k in ("forward", "left", "turn"))]
    trial, walk = going({REQUESTS: requests(np.array([row]))}), WalkEngine(biped(model), values)
    walk.reset(seen(model, 0.0, trial, len(values)))
    return np.array([walk.command(seen(model, t, trial, len(values))) for t in np.arange(0.0, seconds, 0.01)])


def soles(model: Model, command: Array) -> Array:
    """(2,) heights of the lowest points of both soles, in m, of a torso that is held at 0 and upright."""
    m, data = model.compiled, mujoco.MjData(model.compiled)
    data.qpos[:] = m.qpos0
    data.qpos[:7] = (0, 0, 0, 1, 0, 0, 0)
    for joint, actuator in model.drives().items():
        if actuator:
            data.qpos[m.jnt_qposadr[model.index("joint", joint)]] = command[model.columns()[actuator]]
    data.joint("RHipYawPitch").qpos[:] = data.joint("LHipYawPitch").qpos
    mujoco.mj_kinematics(m, data)
    lowest = []
    for side in "LR":
        ids = [i for i, n in enumerate(model.names("geom")) if m.geom_contype[i] and n.startswith(f"{side}_")]
        box = [m.geom_type[i] == mujoco.mjtGeom.mjGEOM_BOX for i in ids]
        down = [
            abs(data.geom_xmat[i].reshape(3, 3)[2]) @ m.geom_size[i] if b else m.geom_size[i, 0]
            for i, b in zip(ids, box, strict=True)
        ]
        lowest.append(min(data.geom_xpos[ids, 2] - down))
    return np.array(lowest)


@pytest.mark.parametrize("path", [NAO, SIMSPARK], ids=["nao", "simspark"])
def test_legs_reach_the_pose_they_are_asked_for_by_mujocos_own_kinematics(path) -> None:
    model = load(path)
    robot, m, rng = biped(model), load(path).compiled, np.random.default_rng(0)
    yaw, data = rng.uniform(-0.4, 0.4, (40, 2)), mujoco.MjData(m)
    roll, pitch, foot_roll, foot_pitch = rng.uniform(-0.3, 0.3, (4, 40, 2))
    length = robot.legs.longest * rng.uniform(0.7, 0.99, (40, 2))
    angles = robot.legs.angles(yaw, roll, pitch, length, foot_roll, foot_pitch)
    for i in range(40):
        data.qpos[:] = m.qpos0
        data.qpos[:7], data.qpos[robot.places] = (0, 0, 0, 1, 0, 0, 0), angles[i]
        mujoco.mj_kinematics(m, data)
        for side, names in enumerate((LEFT, RIGHT)):
            turned = Rotation.from_euler("z", yaw[i, side] * robot.legs.yaw[side, 2])
            leg = turned * Rotation.from_euler("x", roll[i, side])
            down = leg.apply([np.sin(pitch[i, side]), 0.0, -np.cos(pitch[i, side])])
            ankle = data.xanchor[model.index("joint", names[4])]
            assert ankle == pytest.approx(robot.legs.hips[side] + length[i, side] * down, abs=1e-9)
            sole = turned * Rotation.from_euler("x", foot_roll[i, side]) * Rotation.from_euler("y", foot_pitch[i, side])
            normal = data.body(f"{'LR'[side]}_foot").xmat.reshape(3, 3)[:, 2]
            assert normal == pytest.approx(sole.apply([0.0, 0.0, 1.0]), abs=1e-9)


KINDS = {"yaw": "0 0 1", "roll": "1 0 0", "pitch": "0 1 0"}
BUILDS = {
    "pitch first, its axes apart": (
        "hip_pitch hip_roll hip_yaw knee_pitch ankle_pitch ankle_roll", "0 .02 -.02|0 0 -.08|-.014 0 -.13|0 0 -.28|0 0 -.012"
    ),
    "ankle roll first": (
        "hip_yaw hip_roll hip_pitch knee_pitch ankle_roll ankle_pitch", "0 0 -.05|0 0 0|0 0 -.2|0 0 -.2|.01 0 -.02"
    ),
    "without a yaw": ("hip_roll hip_pitch knee_pitch ankle_pitch ankle_roll", "0 0 0|0 0 -.2|0 0 -.2|0 0 0"),
    "without an ankle roll": ("hip_yaw hip_roll hip_pitch knee_pitch ankle_pitch", "0 0 0|0 0 0|0 0 -.2|0 0 -.2"),
}  # fmt: skip


def legged(build: str, side: str = "-1", knee: str = "-.1 2.3") -> tuple[Model, list[list[str]]]:
    """A biped whose right leg's pitches turn the other way, and its legs' joints in the order of the alphabet."""
    joints, shifts = BUILDS[build]
    text, names = "", []
    for s, y, turn in (("l", ".1", "1"), ("r", "-.1", side)):
        own = [f"{s}_{j}" for j in joints.split()]
        leg = '<geom size=".01" mass=".1"/>'
        for name, shift in reversed(list(zip(own, [f"0 {y} -.1", *shifts.split("|")], strict=True))):
            kind = name.rpartition("_")[2]
            axis = KINDS[kind].replace("1", turn) if kind == "pitch" else KINDS[kind]
            limits = knee if "knee" in name and turn == "1" else "-2.4 2.4"
            joint = f'<joint name="{name}" axis="{axis}" range="{limits}"/>'
            heavy = '<inertial pos="0 0 0" mass=".1" diaginertia="1e-4 1e-4 1e-4"/>'
            leg = f'<body name="{name}" pos="{shift}">{heavy}{joint}{leg}</body>'
        text, names = text + leg, [*names, sorted(own)]
    servos = "".join(f'<position joint="{n}" kp="9"/>' for side in names for n in side)
    whole = (
        '<mujoco><compiler angle="radian"/><worldbody><body name="torso"><freejoint/><geom size=".1"/>'
        f"{text}</body></worldbody><actuator>{servos}</actuator></mujoco>"
    )
    spec = mujoco.MjSpec.from_string(whole)
    return Model(Path("biped.xml"), spec, spec.compile()), names


@pytest.mark.parametrize("build", BUILDS)
def test_legs_of_another_build_reach_the_pose_they_are_asked_for(build: str) -> None:
    model, (left, right) = legged(build)
    robot, m, rng = biped_of(model, left, right), model.compiled, np.random.default_rng(0)
    has, data = robot.legs.signs != 0.0, mujoco.MjData(model.compiled)
    yaw = rng.uniform(-0.3, 0.3, (20, 2)) * has[:, 0]
    roll, pitch, foot_roll, foot_pitch = rng.uniform(-0.25, 0.25, (4, 20, 2))
    length = robot.legs.longest * rng.uniform(0.75, 0.95, (20, 2))
    angles = robot.legs.angles(yaw, roll, pitch, length, foot_roll, foot_pitch)
    feet = [int(m.jnt_bodyid[max(model.index("joint", n) for n in names)]) for names in (left, right)]
    mujoco.mj_kinematics(m, data)
    at_zero = [robot.legs.ankles[s] - data.xpos[f] for s, f in enumerate(feet)]
    for i in range(20):
        data.qpos[robot.places[has]] = angles[i][has]
        mujoco.mj_kinematics(m, data)
        for side, foot in enumerate(feet):
            turned, ground = Rotation.from_euler("z", yaw[i, side]), data.xmat[foot].reshape(3, 3)
            leg = turned * Rotation.from_euler("x", roll[i, side])
            down = leg.apply([np.sin(pitch[i, side]), 0.0, -np.cos(pitch[i, side])])
            ankle = data.xpos[foot] + ground @ at_zero[side]
            assert ankle == pytest.approx(robot.legs.hips[side] + length[i, side] * down, abs=1e-6)
            sole = turned * Rotation.from_euler("x", foot_roll[i, side]) * Rotation.from_euler("y", foot_pitch[i, side])
            off = sole.as_matrix().T @ ground
            if has[0, 5]:
                assert [off[1, 2], off[0, 2] * has[0, 0]] == pytest.approx(
                    [0.0, 0.0], abs=0.05 * (not has[0, 0]) + 1e-6
                )
            if has[0, 0]:
                assert off[1, 0] == pytest.approx(0.0, abs=1e-6)


def test_the_right_leg_does_half_a_cycle_later_what_the_left_leg_does() -> None:
    model = load(NAO)
    values = PARAMETERS.nominal[None].copy()
    values[0, PARAMETERS.index("stepPeriod")] = 0.5
    columns = biped(model).columns
    commands = walked(model, 4.0, values, forward=0.7)[:, 0]
    mirror = np.array([1.0, -1.0, 1.0, 1.0, 1.0, -1.0])[1:]  # rolls turn the other way
    left, right = commands[:, columns[0, 1:]], commands[:, columns[1, 1:]]
    steady = slice(300, 350)
    assert left[steady] * mirror == pytest.approx(right[325:375], abs=1e-9)
    assert np.ptp(left[steady, 1]) > 0.1  # and it does something


@pytest.mark.parametrize("path", [NAO, SIMSPARK], ids=["nao", "simspark"])
def test_one_foot_clears_the_ground_while_the_other_carries(path) -> None:
    model = load(path)
    heights = np.array([soles(model, c) for c in walked(model, 3.5, PARAMETERS.nominal[None], forward=0.67)[290:, 0]])
    between = heights[:, 0] - heights[:, 1]
    assert between.max() > 0.008
    assert between.min() < -0.008


def test_turning_left_turns_the_lifted_left_foot_outward_and_the_standing_one_back() -> None:
    model = load(NAO)
    robot = biped(model)
    commands = walked(model, 4.0, PARAMETERS.nominal[None], turn=1.0)[:, 0]
    shared = commands[250:, robot.columns[0, 0]]
    assert np.ptp(shared) > 0.1
    heights = np.array([soles(model, c) for c in commands[250:]])
    up_left = heights[:, 0] - heights[:, 1]
    # Positive angles of the shared joint turn both toes inward: the left foot turns left while it is up.
    assert np.corrcoef(np.gradient(shared), up_left)[0, 1] < -0.3


def test_rows_walk_as_each_would_alone() -> None:
    model, rng = load(SIMSPARK), np.random.default_rng(1)
    values = PARAMETERS.from_unit(rng.uniform(0.3, 0.7, (4, len(PARAMETERS))))
    together = walked(model, 2.0, values, forward=0.5, left=0.3, turn=-0.4)
    for k in range(4):
        alone = walked(model, 2.0, values[k : k + 1], forward=0.5, left=0.3, turn=-0.4)
        assert together[:, k] == pytest.approx(alone[:, 0], abs=1e-12)


def test_commands_stay_within_the_joints_ranges_and_begin_at_the_start_pose() -> None:
    model = load(NAO)
    robot = biped(model)
    values = PARAMETERS.from_unit(np.random.default_rng(2).uniform(0.0, 1.0, (20, len(PARAMETERS))))
    commands = walked(model, 3.0, values, forward=1.0, left=1.0, turn=1.0)
    moved = robot.columns >= 0
    angles = commands[:, :, robot.columns[moved]]
    assert np.all(angles >= robot.legs.lower[moved])
    assert np.all(angles <= robot.legs.upper[moved])
    start = model.compiled.key_qpos[0][robot.places[moved]]
    assert commands[0][:, robot.columns[moved]] == pytest.approx(np.tile(start, (20, 1)), abs=1e-9)


def test_the_lean_is_found_from_gyro_and_accelerometer_though_the_gyro_is_off() -> None:
    model, attitude = load(NAO), Complementary(memory=0.5)
    trial, dt = going({}), 0.01
    times = np.arange(0.0, 8.0, dt)
    pitch = 0.1 * np.sin(2.0 * times)
    rates = 0.2 * np.cos(2.0 * times) + 0.02  # what the gyro is off by
    found = []
    attitude.reset(seen(model, 0.0, trial))
    for p, w in zip(pitch, rates, strict=True):
        gravity = 9.81 * np.array([[-np.sin(p), 0.0, np.cos(p)]])
        lean = attitude.update(seen(model, 0.0, trial, gyro=np.array([[0.0, w, 0.0]]), accelerometer=gravity), dt)
        found.append(lean.pitch[0])
    late = times > 3.0
    assert np.array(found)[late] == pytest.approx(pitch[late], abs=0.02 * 0.5 + 0.004)  # bias x memory, and a step


def test_the_lean_is_felt_by_whatever_inertial_unit_there_is_however_it_is_mounted() -> None:
    sensors = '<sensor><gyro name="imu_w" site="imu"/><accelerometer name="imu_a" site="imu"/></sensor>'
    site = '<site name="imu" euler="180 0 90"/>'
    body = f'<body><freejoint/><geom size=".1"/>{site}</body>'
    spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{body}</worldbody>{sensors}</mujoco>")
    (gyro, turned), (accelerometer, tilted) = inertial(Model(Path("biped.xml"), spec, spec.compile())).values()
    assert (gyro, accelerometer) == ("imu_w", "imu_a")
    trial, model = going({}), load(NAO)
    gravity, rates = np.array([[-1.0, 2.0, 9.5]]), np.array([[0.3, -0.2, 0.1]])
    lean = []
    for attitude, felt in (
        (Complementary(), {"gyro": rates, "accelerometer": gravity}),
        (
            Complementary(gyro, accelerometer, mounted=(turned, tilted)),
            {gyro: rates @ turned, accelerometer: gravity @ tilted},
        ),
    ):
        attitude.reset(seen(model, 0.0, trial, 1, **felt))
        lean.append(attitude.update(seen(model, 0.0, trial, 1, **felt), 0.01))
    assert abs(turned[2, 2] + 1.0) < 1e-9
    for name in ("roll", "pitch", "roll_rate", "pitch_rate"):
        assert getattr(lean[1], name) == pytest.approx(getattr(lean[0], name))


def test_a_first_sample_that_is_far_off_is_one_among_many() -> None:
    model, trial, attitude = load(NAO), going({}), Complementary(memory=1.0)
    attitude.reset(seen(model, 0.0, trial))
    for k in range(50):
        shown = 9.81 * np.array([[0.0, np.sin(0.5 * (k == 0)), np.cos(0.5 * (k == 0))]])
        lean = attitude.update(seen(model, 0.0, trial, accelerometer=shown), 0.01)
        assert lean.roll[0] == pytest.approx(0.5 / (k + 1))


def test_a_body_that_falls_freely_changes_nothing_for_those_beside_it() -> None:
    model, trial, dt = load(NAO), going({}), 0.01
    leaning = 9.81 * np.array([np.sin(0.2), 0.0, np.cos(0.2)])

    def felt(rows: int) -> Array:
        attitude = Complementary()
        attitude.reset(seen(model, 0.0, trial, rows))
        shown = np.vstack([leaning, np.zeros((rows - 1, 3))])  # the others feel no weight
        felt_here = seen(model, 0.0, trial, rows, gyro=np.full((rows, 3), 0.3), accelerometer=shown)
        lean = [attitude.update(felt_here, dt) for _ in range(5)][-1]
        return np.array([lean.roll[0], lean.pitch[0]])

    assert np.array_equal(felt(1), felt(4))


def test_a_walk_turns_toward_its_target_and_stands_where_there_is_none() -> None:
    model = load(NAO)
    trial = going({TARGETS: targets(np.array([[0.0, 0.0, 5.0, 0.6, 0.0], [1.0, 0.0, 5.0, 1.0, 1.0],
                                              [2.0, np.nan, np.nan, 1.0, 0.0]]))})  # fmt: skip
    asked = [OfTrial()(seen(model, t, trial))[0] for t in (0.5, 1.5, 2.5)]
    assert asked[0] == pytest.approx([0.0, 0.0, 0.6], abs=1e-6)  # straight to the left: it turns first
    assert asked[1] == pytest.approx([0.0, 1.0, 1.0], abs=1e-6)
    assert asked[2] == pytest.approx([0.0, 0.0, 0.0])


def test_what_cannot_walk_is_named() -> None:
    model = load(NAO)
    with pytest.raises(ParameterError, match="17 parameters"):
        WalkEngine(biped(model), np.zeros((2, 3)))
    with pytest.raises(ModelError, match=r"2 joints that pitch.*hip, knee and ankle.*'LAnklePitch' \(pitch\)"):
        biped_of(model, (*LEFT[:3], *LEFT[4:]), (*RIGHT[:3], *RIGHT[4:]))
    with pytest.raises(ModelError, match=r"'RAnkleRoll'.*not below 'LAnkleRoll'.*joints of one leg"):
        biped_of(model, (*LEFT, RIGHT[5]), RIGHT)
    bird, legs = legged("without a yaw", knee="-2.3 0")
    with pytest.raises(ModelError, match="'l_knee_pitch' bends the knee to the front by 0 rad"):
        biped_of(bird, *legs)
    with pytest.raises(TrialError, match="does not say where to walk"):
        OfTrial()(seen(model, 0.0, going({})))
    with pytest.raises(UnknownNameError, match="feel"):
        Complementary("gyroscope").reset(seen(model, 0.0, going({})))
