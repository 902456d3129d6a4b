# SPDX-License-Identifier: Apache-2.0
"""DART and MuJoCo agree where physics leaves no choice, and DART keeps the contracts of engines and simulators."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("dartpy", reason="the second engine is an extra: pip install trueup[dart]")

from trueup.articulated.declarations import Declaration
from trueup.articulated.simulator import ArticulatedSimulator
from trueup.chance import Push, Sensing, StartScatter
from trueup.controllers.controller import Observation
from trueup.controllers.playback import Playback
from trueup.ends import Fallen
from trueup.engines.dart import load, simulator
from trueup.engines.dart.model import of
from trueup.engines.mujoco.model import load as load_file
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.errors import ModelError, UnknownNameError
from trueup.loop.settle import settled
from trueup.recording import Channel
from trueup.studies.balance.scenes import STAND, model_of, pose_of
from trueup.testing import check_attributes, check_simulator
from trueup.trial import Observed, Trial

Array = NDArray[np.float64]

ARM = """<mujoco><worldbody>
  <body name="upper" pos="0 0 1"><joint name="shoulder" axis="0 1 0" damping="0.05" armature="0.01"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.6" contype="0" conaffinity="0"/>
    <body name="fore" pos="0 0 -0.3" euler="0 0 40"><joint name="elbow" axis="0 1 0" pos="0 0.01 0" damping="0.02"/>
      <geom type="box" pos="0.05 0 -0.12" size="0.03 0.02 0.12" mass="0.3" contype="0" conaffinity="0"/>
      <body name="rod" pos="0 0 -0.24"><joint name="slide" type="slide" axis="0 0 1" damping="2" range="-0.1 0.1"/>
        <geom type="sphere" size="0.02" mass="0.1" contype="0" conaffinity="0"/></body></body></body>
  </worldbody>
  <actuator><position name="shoulder" joint="shoulder" kp="8" kv="0.4" forcerange="-1.5 1.5"/>
    <position name="elbow" joint="elbow" kp="4"/><position name="slide" joint="slide" kp="200"/></actuator>
</mujoco>"""
BALL = """<mujoco><worldbody><geom name="floor" type="plane" size="2 2 0.1" friction="0.5"/>
  <body name="box" pos="0 0 1"><freejoint/><geom name="box" type="box" size="0.1 0.1 0.1" mass="2" friction="0.5"/></body>
  </worldbody></mujoco>"""


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    (tmp_path / "arm.xml").write_text(ARM)
    return tmp_path / "arm.xml"


def swing(duration: float = 1.0, command: Array | None = None) -> Trial:
    joints = ("shoulder", "elbow", "slide")
    time, start = np.arange(0.0, duration, 0.02), np.zeros(1)
    given = np.array([[0.4, -0.5, 0.02]]) if command is None else command
    return Trial(
        "swing", 0.0, duration, Channel("command", joints, "rad", start, given),
        {"position": Observed(joints, "rad", time), "velocity": Observed(joints, "rad/s", time)},
        {"position": Channel("position", joints, "rad", start, np.array([[0.3, 0.2, 0.0]]))},
    )  # fmt: skip


def base_at(x: float, z: float, pitch: float = 0.0) -> dict[str, Channel]:
    start = np.zeros(1)
    return {
        "base_position": Channel("base_position", ("x", "y", "z"), "m", start, np.array([[x, 0.0, z]])),
        "base_orientation": Channel(
            "base_orientation", ("roll", "pitch", "yaw"), "rad", start, np.array([[0.0, pitch, 0.0]])
        ),
    }


def test_servos_step_alike_within_their_limits(arm: Path) -> None:
    ours, theirs = (s.rollout([swing()], np.zeros((1, 0)))[0] for s in (
        simulator(load(arm), step=0.0005), MujocoSimulator(load_file(arm), step=0.0001),
    ))  # fmt: skip
    moved = np.ptp(theirs.channels["position"][0], axis=0)
    apart = np.abs(ours.channels["position"] - theirs.channels["position"])[0].max(axis=0)
    assert (apart < 0.01 * moved).all(), apart / moved


def test_a_pendulum_swings_alike_and_keeps_its_energy(tmp_path: Path) -> None:
    text = ARM.replace('damping="0.05"', "").replace('damping="0.02"', "").replace('armature="0.01"', "")
    text = text[: text.index("<actuator>")] + '<actuator><motor name="shoulder" joint="shoulder"/></actuator></mujoco>'
    (tmp_path / "free.xml").write_text(text.replace('damping="2"', 'damping="500"'))
    trial = swing(2.0)
    trial = Trial("swing", 0.0, 2.0, None, trial.observed, trial.initial)
    silent = Channel("command", ("shoulder",), "N m", np.zeros(1), np.zeros((1, 1)))
    file = tmp_path / "free.xml"
    simulators = simulator(load(file), step=0.0005), MujocoSimulator(load_file(file), step=0.0005)
    runs = [s.rollout([trial], np.zeros((1, 0)), lambda v: Playback(silent, len(v)))[0] for s in simulators]
    ours, theirs = (r.channels["position"][0, :, :2] for r in runs)
    assert np.abs(ours - theirs).max() < 0.01 * np.ptp(theirs)


def test_a_body_whose_weight_is_compensated_stays_where_it_is_in_dart_too(tmp_path: Path) -> None:
    (tmp_path / "held.xml").write_text(BALL.replace("<body ", '<body gravcomp="1" ', 1))
    observed = {"base_position": Observed(("x", "y", "z"), "m", np.arange(0.0, 1.0, 0.01))}
    trial = Trial("hang", 0.0, 1.0, None, observed, base_at(0.3, 1.0))
    (run,) = simulator(load(tmp_path / "held.xml"), step=0.001).rollout([trial], np.zeros((1, 0)))
    np.testing.assert_allclose(run.channels["base_position"][0, :, 2], 1.0, atol=1e-9)


def test_a_free_body_falls_by_half_g_t_squared_and_then_rests_on_the_floor(tmp_path: Path) -> None:
    (tmp_path / "box.xml").write_text(BALL)
    time = np.arange(0.0, 2.0, 0.01)
    trial = Trial(
        "fall", 0.0, 2.0, None, {"base_position": Observed(("x", "y", "z"), "m", time)}, base_at(0.3, 1.0)
    )  # fmt: skip
    (run,) = simulator(load(tmp_path / "box.xml"), step=0.001).rollout([trial], np.zeros((1, 0)))
    place = run.channels["base_position"][0]
    falling = time < 0.4
    np.testing.assert_allclose(place[falling, 2], 1.0 - 0.5 * 9.81 * time[falling] ** 2, atol=0.003)
    np.testing.assert_allclose(place[:, 0], 0.3, atol=1e-3)
    assert place[-1, 2] == pytest.approx(0.1, abs=2e-3)


def test_friction_of_the_floor_decides_how_far_a_box_slides(tmp_path: Path) -> None:
    (tmp_path / "slope.xml").write_text(BALL.replace("<worldbody>", '<option gravity="4 0 -9"/><worldbody>', 1))
    time = np.arange(0.0, 0.8, 0.02)
    trial = Trial(
        "slide", 0.0, 0.8, None, {"base_position": Observed(("x", "y", "z"), "m", time)},
        base_at(0.0, 0.1),
    )  # fmt: skip
    made = simulator(load(tmp_path / "slope.xml"), [Declaration("floor_friction", ("world",))], step=0.001)
    (run,) = made.rollout([trial], np.array([[0.3], [0.49]]))
    gone = run.channels["base_position"][:, -1, 0]
    assert gone[1] < 0.01  # the floor holds it: 0.49 x 9 N/kg beats 4
    assert gone[0] == pytest.approx(0.5 * (4.0 - 0.3 * 9.0) * time[-1] ** 2, rel=0.05)


def test_the_humanoid_stands_alike_in_both() -> None:
    model = model_of("kneel-to-stand")
    joints, heights = model.names("actuator"), [0.3, 0.302, 0.304]
    rests = [
        settled(s, joints, pose_of(joints, STAND), heights, seconds=1.0)
        for s in (simulator(of(model)), MujocoSimulator(model))
    ]
    ours, theirs = ({n: c.values[0] for n, c in rest.items()} for rest in rests)
    assert ours["base_position"][2] == pytest.approx(theirs["base_position"][2], rel=0.01)
    np.testing.assert_allclose(ours["position"], theirs["position"], atol=0.02)
    assert abs(ours["base_orientation"][1] - theirs["base_orientation"][1]) < 0.02


def test_a_fall_ends_a_run_in_dart_too() -> None:
    model = model_of("kneel-to-stand")
    joints, start, time = model.names("actuator"), np.zeros(1), np.arange(0.0, 1.5, 0.02)
    trial = Trial(
        "fall", 0.0, 1.5, Channel("command", joints, "rad", start, pose_of(joints, STAND)[None]),
        {"base_position": Observed(("x", "y", "z"), "m", time)},
        {
            "position": Channel("position", joints, "rad", start, pose_of(joints, STAND)[None]),
            **base_at(0.0, 0.305, 0.5),
        },
        ends=(Fallen(height=0.15),),
    )  # fmt: skip
    (run,) = simulator(of(model)).rollout([trial], np.zeros((2, 0)))
    assert {e.name for e in run.ends.values()} == {"fallen"}
    assert run.ends[0].at < 1.4
    assert np.isnan(run.channels["base_position"][0, -1]).all()


def test_what_is_written_is_simulated(arm: Path) -> None:
    model = load(arm)
    lines = [Declaration("kp", ("shoulder",)), Declaration("damping", ("elbow",)), Declaration("mass", ("fore",))]
    made = simulator(model, lines, step=0.001)
    assert isinstance(made, ArticulatedSimulator)
    values = np.tile(made.parameters.nominal, (4, 1))
    for k in range(3):
        values[k + 1, k] *= 1.5
    ((ours,), (theirs,)) = (
        s.rollout([swing()], values)
        for s in (made, MujocoSimulator(load_file(arm), made.parameters, made.quantities, step=0.001))
    )
    change = theirs.channels["position"][1:] - theirs.channels["position"][:1]
    seen = ours.channels["position"][1:] - ours.channels["position"][:1]
    for k in range(3):
        assert np.abs(change[k]).max() > 1e-3
        assert np.abs(seen[k] - change[k]).max() < 0.05 * np.abs(change[k]).max()


def test_it_keeps_the_contracts(arm: Path) -> None:
    model = load(arm)
    offered = check_attributes(model, model.copies(3), 3)
    assert {"joint.damping", "actuator.kp", "body.mass"} <= set(offered)
    trial = swing(0.5)
    (run,) = simulator(model, step=0.001).rollout([trial], np.zeros((1, 0)))
    check_simulator(simulator(model, [Declaration("kp", ("*",))], step=0.001), run.recording())


def test_what_dart_cannot_have_is_named(tmp_path: Path) -> None:
    (tmp_path / "two.xml").write_text(
        ARM.replace('<joint name="elbow"', '<joint name="x" axis="1 0 0"/><joint name="elbow"')
    )
    with pytest.raises(ModelError, match="body 'fore' has 2 joints"):
        load(tmp_path / "two.xml").copies(1)
    (tmp_path / "arm.xml").write_text(ARM)
    with pytest.raises(UnknownNameError, match=r"joint\.backlash"):
        simulator(load(tmp_path / "arm.xml"), [Declaration("backlash", ("elbow",))]).rollout(
            [swing()], np.zeros((1, 1))
        )


CORNERS = "-0.05 -0.04 -0.03 0.07 -0.04 -0.03 0.07 0.04 -0.03 -0.05 0.04 -0.03 0.02 0 0.05 0.01 0.01 -0.01"
MESHED = f"""<mujoco><option gravity="0 0 -9.81"/><asset><mesh name="rock" vertex="{CORNERS}"/></asset><worldbody>
  <geom name="floor" type="plane" size="2 2 0.1" friction="0.3" priority="1"/>
  <body name="rock" pos="0 0 1"><freejoint/><geom name="rock" type="mesh" mesh="rock" mass="2" friction="0.3"/>
    <body name="beam" pos="0.01 0 0.06"><joint name="hip" axis="0 1 0" damping="0.5" armature="0.01"/>
      <geom type="capsule" fromto="0 0 0 0.05 0 0" size="0.01" mass="0.4" contype="0" conaffinity="0"/></body></body>
  </worldbody><actuator><position name="hip" joint="hip" kp="4" forcerange="-3 3"/></actuator></mujoco>"""


def rock_and_seen(tmp_path: Path, trial: Trial, lines: list[Declaration], values: Array) -> list[dict[str, Array]]:
    """The same runs in DART and in MuJoCo."""
    (tmp_path / "rock.xml").write_text(MESHED)
    made = simulator(load(tmp_path / "rock.xml"), lines, step=0.0005)
    other = MujocoSimulator(load_file(tmp_path / "rock.xml"), made.parameters, made.quantities, step=0.0005)
    return [s.rollout([trial], values)[0].channels for s in (made, other)]  # type: ignore[misc]


def test_a_mesh_falls_lies_and_bears_as_in_mujoco(tmp_path: Path) -> None:
    time = np.arange(0.0, 1.5, 0.01)
    trial = Trial(
        "lie", 0.0, 1.5, Channel("command", ("hip",), "rad", np.zeros(1), np.zeros((1, 1))),
        {"base_position": Observed(("x", "y", "z"), "m", time), "position": Observed(("hip",), "rad", time)},
        base_at(0.0, 0.1),
    )  # fmt: skip
    ours, theirs = rock_and_seen(tmp_path, trial, [], np.zeros((1, 0)))
    falling = time < 0.08
    np.testing.assert_allclose(ours["base_position"][0, falling, 2], 0.1 - 0.5 * 9.81 * time[falling] ** 2, atol=2e-3)
    # At rest it lies on its flat side, and the servo bears the beam.
    fallen = ours["base_position"][0, -1, 2], theirs["base_position"][0, -1, 2]
    assert fallen[0] == pytest.approx(fallen[1], rel=0.01)
    sagged = ours["position"][0, -1, 0], theirs["position"][0, -1, 0]
    assert abs(sagged[1]) > 0.02
    assert sagged[0] == pytest.approx(sagged[1], rel=0.01)


def test_a_mesh_slides_down_a_floor_that_is_tilted_as_in_mujoco(tmp_path: Path) -> None:
    time, tilt = np.arange(0.0, 1.0, 0.01), np.array([0.35, 0.5])
    trial = Trial("slide", 0.0, 0.99, None, {"base_position": Observed(("x", "y", "z"), "m", time)}, base_at(0.0, 0.0))
    lines = [Declaration("floor_pitch", lower=-0.6, upper=0.6), Declaration("floor_height", nominal=0.0)]
    gone = []
    for angle in tilt:
        trial = replace(trial, initial=base_at(0.03 * np.sin(angle), 0.03 * np.cos(angle), angle))  # on its flat side
        ours, theirs = rock_and_seen(tmp_path, trial, lines, np.array([[angle, 0.0]]))
        far = [np.linalg.norm(r["base_position"][0, -1] - r["base_position"][0, 0]) for r in (ours, theirs)]
        assert far[0] == pytest.approx(far[1], rel=0.01)
        gone.append(far[0])
    law = 0.5 * 9.81 * (np.sin(tilt) - 0.3 * np.cos(tilt)) * time[-1] ** 2
    np.testing.assert_allclose(gone, law, rtol=0.02)


SENSORS = """<sensor><gyro name="gyro" site="imu"/><accelerometer name="felt" site="imu"/>
  <framequat name="turned" objtype="site" objname="imu"/><jointvel name="pace" joint="elbow"/>
  <actuatorfrc name="push" actuator="shoulder"/><subtreecom name="com" body="upper"/><force name="grip" site="imu"/>
  </sensor></mujoco>"""


def test_a_robots_sensors_tell_in_dart_what_they_tell_in_mujoco(tmp_path: Path) -> None:
    imu = '<site name="imu" pos="0.03 0.01 -0.1" euler="20 30 40"/><joint name="slide"'
    text = ARM.replace('<joint name="slide"', imu).replace("</mujoco>", SENSORS)
    (tmp_path / "arm.xml").write_text(text)
    made = simulator(load(tmp_path / "arm.xml"), step=0.0005)
    channels = made.engine.channels()
    assert set(channels) == {"gyro", "felt", "turned", "pace", "push"}
    assert channels["gyro"] == ("gyro.x", "gyro.y", "gyro.z")
    time = np.arange(0.05, 0.6, 0.01)
    trial = replace(swing(0.7), observed={n: Observed(labels, "", time) for n, labels in channels.items()})
    ours, theirs = (
        s.rollout([trial], np.zeros((1, 0)))[0].channels
        for s in (made, MujocoSimulator(load_file(tmp_path / "arm.xml"), step=0.0001))
    )
    for name, values in theirs.items():
        size = np.abs(values - values.mean(axis=1, keepdims=True)).max()
        apart = np.abs(ours[name] - values)
        assert np.sqrt(np.mean(apart**2)) < 0.01 * max(size, 0.1), name
    late = replace(trial, sensing=(Sensing("gyro", 0.1, 0.03),)).seeded(np.random.default_rng(1))
    seen: list[Array] = []

    class Watching(Playback):
        def command(self, observation: Observation) -> Array:
            seen.append(np.array(observation.sensors["gyro"][0]))
            return super().command(observation)

    assert trial.command is not None
    command = trial.command
    for one in (trial, late):
        made.rollout([one], np.zeros((1, 0)), lambda v: Watching(command, len(v), period=0.01))
    clean, noisy = np.array(seen).reshape(2, -1, 3)
    error = noisy[10:60] - clean[7:57]  # what was so 0.03 s ago, and noise
    assert np.std(error) == pytest.approx(0.1, rel=0.25)


PUSHED = BALL.replace("<geom name=", "<geom contype='0' conaffinity='0' name=", 1)


def test_pushes_scatter_and_noise_are_those_of_mujoco(tmp_path: Path) -> None:
    (tmp_path / "box.xml").write_text(PUSHED)
    time = np.arange(0.0, 0.5, 0.01)
    trial = Trial(
        "pushed", 0.0, 0.5, None,
        {"base_position": Observed(("x", "y", "z"), "m", time),
         "base_orientation": Observed(("roll", "pitch", "yaw"), "rad", time)}, base_at(0.0, 5.0, 0.4),
        disturbances=(Push("box", (4.0, 8.0), (0.05, 0.2), (0.05, 0.1)), StartScatter("base_position", 0.1),
                      StartScatter("base_orientation", 0.2)),
        sensing=(Sensing("base_position", 0.01, 0.02),),
    ).seeded(np.random.default_rng(3))  # fmt: skip
    file = tmp_path / "box.xml"
    ours, theirs = (
        s.rollout([trial], np.zeros((3, 0)))[0].channels
        for s in (simulator(load(file), step=0.0005), MujocoSimulator(load_file(file), step=0.0005))
    )
    moved = np.ptp(theirs["base_position"][:, :, :2], axis=1)
    assert (moved > 0.02).all()
    np.testing.assert_allclose(
        ours["base_position"], theirs["base_position"], atol=3e-3
    )  # the same chance, drawn alike
    np.testing.assert_allclose(ours["base_orientation"], theirs["base_orientation"], atol=1e-6)


def test_a_push_changes_the_momentum_by_force_times_time(tmp_path: Path) -> None:
    (tmp_path / "box.xml").write_text(PUSHED)
    trial = Trial(
        "pushed", 0.0, 0.6, None, {"base_position": Observed(("x", "y", "z"), "m", np.array([0.4, 0.5]))},
        base_at(0.0, 5.0), disturbances=(Push("box", (6.0, 6.0), (0.1, 0.1), (0.2, 0.2), (0.0, 1.0, 0.0)),),
    ).seeded(np.random.default_rng(0))  # fmt: skip
    (run,) = simulator(load(tmp_path / "box.xml")).rollout([trial], np.zeros((1, 0)))
    (before, after) = run.channels["base_position"][0]
    np.testing.assert_allclose((after - before)[:2] / 0.1, [0.0, 6.0 * 0.2 / 2.0], atol=1e-6)


@pytest.mark.parametrize("engine", ["dart", "mujoco"])
def test_a_controller_in_closed_loop_meets_the_drives_and_sensors_that_a_replay_meets(arm: Path, engine: str) -> None:
    lines = [Declaration("offset", ("shoulder",)), Declaration("speed_limit", ("elbow",)), Declaration("delay", ("elbow",)),
             Declaration("zero", ("elbow",))]  # fmt: skip
    dart = simulator(load(arm), lines)
    made = dart if engine == "dart" else MujocoSimulator(load_file(arm), dart.parameters, dart.quantities)
    time = np.arange(0.0, 1.0, 0.02)
    waves = 0.3 * np.sin(4.0 * time)[:, None] * [1.0, -1.0, 0.1]
    trial = replace(swing(1.0), command=Channel("command", ("shoulder", "elbow", "slide"), "rad", time, waves))
    values = np.array([[0.1, 0.5, 0.03, 0.05]])
    (replayed,) = made.rollout([trial], values)
    seen: list[Array] = []

    class Watching(Playback):
        def command(self, observation: Observation) -> Array:
            seen.append(np.array(observation.position[0]))
            return super().command(observation)

    assert trial.command is not None
    command = trial.command
    (closed,) = made.rollout([trial], values, lambda v: Watching(command, len(v), period=0.02))
    np.testing.assert_allclose(closed.channels["position"], replayed.channels["position"], atol=1e-9)
    measured = replayed.channels["position"][0]  # with the sensor's error, as the controller saw it
    np.testing.assert_allclose(np.array(seen)[: len(measured)], measured, atol=2e-3)
    (plain,) = made.rollout([trial], made.parameters.nominal[None])
    assert np.abs(plain.channels["position"] - replayed.channels["position"]).max() > 0.03
