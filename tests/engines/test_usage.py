# SPDX-License-Identifier: Apache-2.0
"""The lines of code that a calibration ends with replay a log as it was fitted, whatever its period."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.calibration import Calibration, Estimate
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording

PENDULUM = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body><joint name="j" axis="0 1 0"/>
<inertial pos="0 0 -.1" mass=".4" diaginertia="2e-4 2e-4 2e-4"/></body></worldbody>
<actuator><position name="m" joint="j" kp="10" kv=".3"/></actuator></mujoco>"""
LATE = '[[parameter]]\nquantity = "delay"\nof = "*"\nnominal = 0.0128\nfrozen = true\n'


@pytest.mark.parametrize(("period", "lost"), [(0.005, 0), (0.003, 0), (0.01, 0), (0.004, 25)],
                         ids=["2.5 steps", "1.5 steps", "5 steps", "rows lost"])  # fmt: skip
def test_the_lines_replay_the_log_as_it_was_fitted(tmp_path: Path, period: float, lost: int) -> None:
    (tmp_path / "given.xml").write_text(PENDULUM)
    (tmp_path / "late.toml").write_text(LATE)
    rng, time = np.random.default_rng(1), np.arange(0.0, 2.0, period)
    time = np.delete(time, rng.choice(np.arange(1, len(time) - 1), lost, replace=False))
    told = np.sin(12.0 * time + 1.0)[:, None]
    log = Recording("log", {n: Channel(n, ("j",), "rad", time, told) for n in ("command", "position")})
    ready = prepare(tmp_path / "given.xml", [log], parameters=tmp_path / "late.toml")
    (replay,) = ready.compare().replays
    found = Calibration("arm", tuple(
        Estimate(p.name, p.unit, p.nominal, p.nominal, p.nominal, p.nominal, p.lower, p.upper, False, "frozen", "")
        for p in ready.simulator.parameters.parameters), (), (), np.eye(len(ready.simulator.parameters)))  # fmt: skip
    out = tmp_path / "out.xml"
    ready.write(found, out, tmp_path / "parameters.toml")
    seen: list[tuple[float, float]] = []

    def watched(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        seen.append((data.time, data.qpos[0]))
        mujoco.mj_step(model, data)

    lines = "\n".join(ready.usage(found, out)).replace("mujoco.mj_step", "watched")
    lines = lines.replace("while", "data.qpos[0] = begin\nwhile")
    names = {
        "mujoco": mujoco,
        "np": np,
        "watched": watched,
        "times": time,
        "commands": told,
        "begin": replay.after[0, 0],
    }
    exec(lines, names)  # the test's own lines, no user's file
    at, moved = np.array(seen).T
    settled = (time > 0.3) & (time <= at[-1])  # how fast it began is in no line
    apart = np.interp(time, at, moved) - replay.after[:, 0]
    assert np.sqrt(np.mean(apart[settled] ** 2)) < 1e-3  # one step late would be 12e-3, a period taken as 4 ms far more


HUNG = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><geom type="plane" size="1 1 .1"/>
<body name="trunk" pos="0 0 .15"><freejoint/><geom type="box" size=".1 .1 .03" mass="1"/>
<body pos="0 0 -.03"><joint name="j" axis="0 1 0" frictionloss=".02"/>
<geom type="capsule" fromto="0 0 0 0 0 -.11" size=".01" mass=".4"/></body></body></worldbody>
<actuator><position name="m" joint="j" kp="2" kv=".1"/></actuator></mujoco>"""


def test_the_lines_hold_a_base_that_was_held_for_the_fit(tmp_path: Path) -> None:
    """Free, it would stand on its leg: the file has the floor, and the trunk falls over."""
    (tmp_path / "given.xml").write_text(HUNG)
    time = np.arange(0.0, 2.0, 0.01)
    told = 0.6 * np.sin(5.0 * time)[:, None]
    log = Recording("log", {n: Channel(n, ("j",), "rad", time, told) for n in ("command", "position")})
    ready = prepare(tmp_path / "given.xml", [log], propose=False)
    (replay,) = ready.compare().replays
    found = Calibration("leg", (), (), (), np.eye(0))
    ready.write(found, tmp_path / "out.xml", tmp_path / "parameters.toml")
    seen: list[tuple[float, float]] = []

    def watched(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        seen.append((data.time, data.qpos[7]))
        mujoco.mj_step(model, data)

    lines = "\n".join(ready.usage(found, tmp_path / "out.xml")).replace("mujoco.mj_step", "watched")
    exec(
        lines, {"mujoco": mujoco, "np": np, "watched": watched, "times": time, "commands": told}
    )  # the test's own lines
    at, moved = np.array(seen).T
    settled = (time > 0.3) & (time <= at[-1])  # how fast it began is in no line
    apart = np.interp(time, at, moved) - replay.after[:, 0]
    assert np.sqrt(np.mean(apart[settled] ** 2)) < 1e-3
