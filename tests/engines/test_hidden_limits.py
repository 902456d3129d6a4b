# SPDX-License-Identifier: Apache-2.0
"""What firmware does to commands is found without being asked for: limits of acceleration, a steep onset of force."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.articulated.kernels import limited_commands
from trueup.calibration import Calibration
from trueup.loop.calibrate import Options
from trueup.loop.fit import DESCENT
from trueup.loop.prepare import Preparation, prepare
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]

PENDULUM = """<mujoco><option timestep="{step}" integrator="implicitfast"/><worldbody><body>
<joint name="j" axis="0 1 0" damping=".03" armature=".01" frictionloss=".06" solimpfriction=".999 .999 .001"/>
<inertial pos="0 0 -.1" mass=".4" diaginertia="2e-4 2e-4 2e-4"/></body></worldbody>
<actuator><position name="m" joint="j" kp="{kp}" forcerange="-1.2 1.2"/></actuator></mujoco>"""
TRUTH, GUESS = {"step": "1e-3", "kp": "4"}, {"step": "2e-3", "kp": "10"}
NOISE = 3e-4  # rad
PERIOD = 0.01  # s between samples


def chirp(time: Array, seed: int) -> Array:
    """A sweep that becomes too fast for a drive whose acceleration is limited."""
    fastest = (4.0, 4.6, 3.5)[seed]
    return 0.22 * np.sin(2.0 * np.pi * (0.3 * time + 0.5 * (fastest - 0.3) / time[-1] * time**2) + seed)


def slow(time: Array, seed: int) -> Array:
    """Slow waves with small steps on them, under the pendulum's weight."""
    steps = np.random.default_rng(seed).uniform(-0.1, 0.1, 20)[(2.0 * time).astype(int)]
    return 0.8 * np.sin((0.9 + 0.3 * seed) * time) + 0.15 * np.sin(3.1 * time) + steps


def recorded(
    name: str, command: Array, time: Array, acceleration: float = np.inf, punch: float = 0.0, step: str = "1e-3"
) -> Recording:
    """The truth, one `mj_step` after the other; its firmware profiles the command, and pushes at least with its punch."""
    model = mujoco.MjModel.from_xml_string(PENDULUM.format(**{**TRUTH, "step": step}))
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    dt, seen = model.opt.timestep, np.empty(len(time))
    every = round(PERIOD / dt)
    held = np.repeat(command, every)[None, :, None]
    place, pace, out = np.array([[command[0]]]), np.zeros((1, 1)), np.empty_like(held)
    limited_commands(held, np.full((1, 1), np.inf), np.full((1, 1), acceleration), dt, place, pace, out)
    for _ in range(1000):
        data.ctrl[0] = command[0]
        mujoco.mj_step(model, data)
    for k, told in enumerate(out[0, :, 0]):
        if k % every == 0:
            seen[k // every] = data.qpos[0]
        error = told - data.qpos[0]
        data.ctrl[0] = told + np.clip(error / 1e-3, -1.0, 1.0) * punch / 4.0
        mujoco.mj_step(model, data)
    measured = seen + NOISE * rng.standard_normal(len(seen))
    parts = {"command": command, "position": measured}
    return Recording(name, {n: Channel(n, ("j",), "rad", time, v[:, None]) for n, v in parts.items()})


def found(folder: Path, kind: str, seconds: float = 6.0, **firmware: Any) -> tuple[Preparation, Calibration, float]:
    """A calibration of what it proposes itself, and its error in rad on a motion that it has not seen."""
    path, time = folder / "pendulum.xml", np.arange(0.0, seconds, 0.01)
    path.write_text(PENDULUM.format(**GUESS))
    logs = [recorded(f"{kind}{k}", {"chirp": chirp, "slow": slow}[kind](time, k), time, **firmware) for k in range(3)]
    ready = prepare(path, logs[:2], logs[2:])
    done = ready.calibrate(Options(cross_validate=False, lacking=False, stages=DESCENT))
    (replay,) = done.held_out()
    return ready, done, float(np.sqrt(np.mean((replay.after - replay.measured) ** 2)))


def value(done: Calibration, kind: str) -> float:
    """The estimate of the one parameter of a kind."""
    return next(e.value for e in done.estimates if e.name.endswith(kind))


def test_a_limit_of_acceleration_is_found_in_a_chirp_that_becomes_too_fast(tmp_path: Path) -> None:
    ready, done, error = found(tmp_path, "chirp", acceleration=60.0)
    assert value(done, "acceleration_limit") == pytest.approx(
        60.0, rel=0.05
    )  # cracks: last bits decide in which it ends
    limit = next(e for e in done.estimates if e.name.endswith("acceleration_limit"))
    assert limit.low <= 60.0 <= limit.high < 66.0
    assert limit.verdict == "identified"
    assert value(done, "punch") == 0.0
    assert error < 0.033  # 0.066 without it: switching from speeding up to slowing down, it makes cracks in the loss
    said = " ".join(ready.write(done, tmp_path / "out.xml", tmp_path / "parameters.toml"))
    assert "acceleration limit of the command (m) is no part of MJCF" in said


def test_a_servo_that_follows_all_that_it_is_told_is_given_neither(tmp_path: Path) -> None:
    _, done, error = found(tmp_path, "slow")
    assert not [
        e.name for e in done.estimates if e.name.endswith(("_limit", "punch")) and e.fitted and "force" not in e.name
    ]
    assert error < 2.0 * NOISE
    for e in done.estimates:
        if e.name.endswith("force_limit") and not e.fitted:  # the file has one, which nothing here meets
            assert e.value == e.start
            assert "kept at its start value; " in e.note
            assert "met in these recordings" in e.note
        elif e.name.endswith("_limit") and not e.fitted:
            assert e.absent
            assert "left-out errors" in e.note or "nowhere" in e.note
        elif e.name.endswith("_limit"):
            assert e.verdict in ("no effect", "weak")
            assert e.high == e.upper_bound
    assert not any("_limit and" in sentence for sentence in done.unidentified)


def test_a_steep_onset_of_force_is_found_and_written_as_a_second_actuator(tmp_path: Path) -> None:
    ready, done, error = found(tmp_path, "slow", seconds=5.0, punch=0.12, step=GUESS["step"])
    assert value(done, "punch") == pytest.approx(0.12, rel=0.15)
    assert error < 8.0 * NOISE  # its onset is another one
    out = tmp_path / "out.xml"
    said = " ".join(ready.write(done, out, tmp_path / "parameters.toml"))
    assert "punch" not in said
    assert "/onset" in said
    # The file itself, by the lines that are printed, moves as what was fitted did.
    (replay,) = done.held_out()
    log = ready.hold_out[0]
    seen: list[tuple[float, float]] = []

    def watched(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        seen.append((data.time, data.qpos[0]))
        mujoco.mj_step(model, data)

    lines = "\n".join(ready.usage(done, out)).replace("mujoco.mj_step", "watched")
    lines = lines.replace("while", "data.qpos[0] = begin\nwhile")
    exec(lines, {"mujoco": mujoco, "np": np, "watched": watched, "times": log.time,
                 "commands": log.channel("command").values, "begin": log.channel("position").values[0, 0]})  # fmt: skip
    at, moved = np.array(seen).T
    apart = np.interp(log.time, at, moved) - replay.after[:, 0]
    assert np.sqrt(np.mean(apart[100:] ** 2)) < 3e-3  # MuJoCo delays by a step at least, and this by half a millisecond
