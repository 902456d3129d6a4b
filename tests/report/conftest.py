# SPDX-License-Identifier: Apache-2.0
"""Made-up calibrations: an arm whose joints lag, rub and have play, replayed by a poor and by a better model."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from trueup.arrays import Array
from trueup.calibration import Calibration, CrossValidation, Estimate, Replay, TracePoint
from trueup.film import Film, Shape
from trueup.identification.effects import Effect
from trueup.identification.estimation.result import Alignment, Identification, Link, Parameter, Prediction
from trueup.identification.kinematic_tree import from_dh
from trueup.identification.torque_model import TorqueModel

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
TRAINING = ("multisine", "chirp_sweep", "step_response", "friction_gravity", "backlash_detection", "random_waypoints")
HELD_OUT = ("fast_transitions", "hold_under_gravity")
NOISE = 0.0009  # rad


def follow(command: Array, dt: float, bandwidth: float, delay: float) -> Array:
    """A second-order servo's answer to `command` (T,), late by `delay` s."""
    late = np.interp(np.arange(command.size) * dt - delay, np.arange(command.size) * dt, command)
    position, speed, out = late[0], 0.0, np.empty_like(late)
    for i, target in enumerate(late):
        speed += dt * (bandwidth**2 * (target - position) - 1.5 * bandwidth * speed)
        position += dt * speed
        out[i] = position
    return out


def made_up_replay(
    name: str,
    *,
    held_out: bool = False,
    labels: tuple[str, ...] = JOINTS,
    seconds: float = 20.0,
    rate: float = 50.0,
    seed: int = 0,
) -> Replay:
    """A recording of every label with play, noise and an encoder grid, and two models of it."""
    random = np.random.default_rng([seed, *name.encode()])
    time = np.arange(round(seconds * rate)) / rate
    columns: list[list[Array]] = [[], [], [], []]
    for j in range(len(labels)):
        tones = random.uniform(0.1, 1.6, 5)
        command = sum(0.35 / (1 + k) * np.sin(2 * np.pi * f * time + random.uniform(0, 6)) for k, f in enumerate(tones))
        command = np.asarray(command) if j % 3 else np.round(np.asarray(command) * 3) / 3
        truth = follow(command, 1 / rate, 13.0 + j, 0.035)
        play = 0.006 * np.sign(np.gradient(truth)) * (j in (1, 2))
        measured = np.round((truth - play + NOISE * random.standard_normal(time.size)) / 0.00153) * 0.00153
        before = follow(command, 1 / rate, 16.0, 0.01 + 0.003 * j)
        after = follow(command, 1 / rate, 13.2 + j, 0.034) + (0.004 if j == 3 else 0.0)
        for column, values in zip(columns, (command, measured, before, after), strict=True):
            column.append(values)
    command, measured, before, after = (np.stack(c, axis=1) for c in columns)
    noise = np.full(len(labels), NOISE)
    return Replay(name, held_out, "position", labels, "rad", time, measured, before, after, command, noise)


def made_up_estimates(joints: tuple[str, ...] = JOINTS) -> tuple[Estimate, ...]:
    """Five parameters a joint with every verdict among them."""
    random = np.random.default_rng(3)
    kinds = (
        ("kp", "N m/rad", 17.8, 1.0, 60.0),
        ("damping", "N m s/rad", 0.6, 0.0, 3.0),
        ("friction", "N m", 0.05, 0.0, 0.6),
    )
    kinds += (("armature", "kg m²", 0.028, 1e-3, 0.3), ("delay", "s", 0.01, 0.0, 0.1))
    found = []
    for joint in joints:
        for kind, unit, start, low, high in kinds:
            value = start * random.uniform(0.6, 1.7)
            half = value * random.choice([0.004, 0.03, 0.12])
            verdict, note = ("weak", "half width 12 % of the value") if half / value > 0.1 else ("identified", "")
            found.append(
                Estimate(
                    f"{joint}.{kind}", unit, start, value, value - half, value + half, low, high, True, verdict, note
                )
            )
    nan = float("nan")
    change = {
        3: ("not identified", True, (0.001, 0.3), "never accelerates enough: a faster motion would show it"),
        7: ("at bound", True, (0.55, 0.6), "stopped at the upper bound 0.6 N m"),
        12: ("no effect", True, (nan, nan), "the torque never saturates"),
        21: ("not supported", False, (nan, nan), "fitting it raised the held-out error by 3 %"),
        27: ("frozen", False, (nan, nan), ""),
    }
    for index, (verdict, fitted, (low, high), note) in change.items():
        if index < len(found):
            e = found[index]
            value = e.upper_bound if verdict == "at bound" else e.value if fitted else e.start
            found[index] = Estimate(
                e.name, e.unit, e.start, value, low, high, e.lower_bound, e.upper_bound, fitted, verdict, note
            )
    return tuple(found)


def made_up_covariance(estimates: tuple[Estimate, ...]) -> Array:
    """Covariance with the estimates' intervals on its diagonal and some strong pairs."""
    random = np.random.default_rng(4)
    deviation = np.array([(e.high - e.low) / 3.92 if e.high > e.low else 1.0 for e in estimates if e.fitted])
    mixing = random.standard_normal((deviation.size, deviation.size + 40))
    for i in range(0, deviation.size - 1, 5):
        mixing[i] = -mixing[i + 1] + 0.15 * random.standard_normal(mixing.shape[1])
    correlation = np.corrcoef(mixing) if deviation.size > 1 else np.eye(deviation.size)
    return correlation * deviation[:, None] * deviation[None, :]


def made_up_calibration(**changes: object) -> Calibration:
    """Thirty parameters and eight recordings of six joints, two of them held out; `changes` replace fields."""
    estimates = made_up_estimates()
    replays = [made_up_replay(n) for n in TRAINING] + [made_up_replay(n, held_out=True) for n in HELD_OUT]
    errors = 36.1 * np.exp(-np.arange(14) / 2.5) + 6.2
    stages = ["gauss-newton"] * 10 + ["structure"] * 4
    trace = [
        TracePoint(s, 31 * i, 1e4 * e**2, e / 1000, 3.1 * i)
        for i, (s, e) in enumerate(zip(stages, errors, strict=True))
    ]
    fields: dict[str, object] = {
        "model_name": "so101_new_calib",
        "estimates": estimates,
        "replays": tuple(replays),
        "trace": tuple(trace),
        "covariance": made_up_covariance(estimates),
        "unidentified": (
            "Only the sum of elbow_flex.kp and the elbow's force limit is seen by these recordings; a motion that "
            "saturates the elbow servo (a fast lift with payload) would separate them.",
            "gripper.armature: no recording accelerates the gripper enough. A chirp up to 4 Hz would show it.",
        ),
        "warnings": ("Channel 'position' of wrist_roll does not move in hold_under_gravity.",),
        "cross_validation": tuple(CrossValidation(n, 0.036, 0.009 + 0.004 * i, "rad") for i, n in enumerate(TRAINING)),
        "seconds": 203.4,
        "cpu_seconds": 371.2,
        "evaluations": 4123,
        "notes": (
            "Gauss-Newton was picked: the replay is smooth in all fitted parameters.",
            "Clock of step_response moved by 4.1 ms.",
        ),
    }
    return Calibration(**(fields | changes))  # type: ignore[arg-type]


@pytest.fixture(scope="session")
def calibration() -> Calibration:
    return made_up_calibration()


@pytest.fixture(scope="session")
def small() -> Callable[..., Calibration]:
    """A calibration of one joint and one short fitted recording; keyword arguments replace fields."""

    def make(**changes: object) -> Calibration:
        estimates = made_up_estimates(("elbow",))
        replays = (made_up_replay("wave", labels=("elbow",), seconds=6.0),)
        base: dict[str, object] = {
            "estimates": estimates,
            "replays": replays,
            "covariance": np.zeros((0, 0)),
            "cross_validation": (),
            "warnings": (),
            "unidentified": (),
            "notes": (),
            "trace": (),
        }
        return made_up_calibration(**(base | changes))

    return make


@pytest.fixture(scope="session")
def replay() -> Callable[..., Replay]:
    return made_up_replay


@pytest.fixture
def swinging() -> Callable[..., Film]:
    """Makes a film of a rod that swings about the world's y, and a block that lies."""

    def made(name: str = "simulation", rate: float = 25.0) -> Film:
        time = np.arange(20) / rate
        angle = 0.8 * np.sin(2.0 * time)
        place, turn = np.zeros((20, 2, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (20, 2, 1))
        place[:, 1, 2] = 0.5
        turn[:, 1, 0], turn[:, 1, 2] = np.cos(angle / 2), np.sin(angle / 2)
        corners = 0.05 * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        shapes = (
            Shape(1, np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -0.4]]), 0.02, (0.2, 0.4, 0.8)),
            Shape(0, corners, 0.0, (0.5, 0.5, 0.5)),
        )
        return Film(name, shapes, time, place, turn, 0.0, 1)

    return made


MODEL = TorqueModel(
    from_dh([0.1, 0.2], [0.0, 0.0], [0.0, 0.0], joints=("a<b>", "elbow")), np.ones((2, 10)), np.eye(2),
    ((0, Effect("viscous"), 1.0), (1, Effect("coulomb"), 2.0)), np.zeros((2, 10)), ("N m", "N m"),
)  # fmt: skip


def _prediction(name: str, *, held_out: bool, seed: int) -> Prediction:
    rng, t = np.random.default_rng(seed), np.arange(400) / 50.0
    q = np.sin(np.outer(t, [1.0, 1.7]) + seed)
    v = np.cos(np.outer(t, [1.0, 1.7]) + seed)
    measured = 20.0 * q + 3.0 * np.sign(v)
    fitted = measured + rng.normal(size=q.shape)
    return Prediction(
        name, held_out, t, measured, fitted, fitted + 0.1, 20.0 * q, q, v, np.column_stack([q, np.ones(len(t))])
    )


@pytest.fixture
def found() -> Identification:
    """Two joints, one run fitted and one held out, a shift of torque corrected."""
    parameters = (
        Parameter("I1zz + I1m + 0.49 m2", "kg m^2", "inertial", "a<b>", 1.23, 0.01, 1.1, 1.22, "identified"),
        Parameter("mc2x", "kg m", "inertial", "elbow", 0.1, 0.4, np.nan, 0.2, "not seen"),
    )
    return Identification(
        model_name="arm", joints=("a<b>", "elbow"), prismatic=(False, False), units=("N m", "N m"),
        effort=np.array([100.0, np.nan]),
        parameters=parameters, links=(Link("upper", 5.0, (0.1, 0.0, 0.0), (0.1, 0.2, 0.25), True, "mass -1 kg"),),
        predictions=(_prediction("train", held_out=False, seed=0), _prediction("unseen", held_out=True, seed=1)),
        noise=np.ones(2), cross_validation=np.ones((8, 2)), alignment=Alignment(0.004, 0.0001, 500.0, True, 0.1),
        structure=(("viscous",), ("Coulomb",)), model=MODEL, for_file=None,
        cutoff=10.0, rate=50.0, weighting="each joint by its noise", trust=1e-9, pull=1e-6,
        advice=("not seen: mc2x. Accelerate elbow harder",), warnings=("torque comes late",), notes=(), seconds=1.0,
    )  # fmt: skip
