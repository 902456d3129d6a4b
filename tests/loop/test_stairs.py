# SPDX-License-Identifier: Apache-2.0
"""A delay under jumps that saturate a drive acts from one step to the next: no replay tells it any finer."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording

_BENCH = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body><joint name="horn" axis="0 1 0"
damping=".08" frictionloss=".09" armature=".0085"/><inertial pos="0 0 -.15" mass=".25" diaginertia="2e-4 2e-4 1e-5"/>
</body></worldbody><actuator><position joint="horn" kp="11" kv=".42" forcerange="-1.6 1.6"/></actuator></mujoco>"""
_DELAY, _STEP, _RATE = 0.02, 0.0005, 50


def _jumps() -> Recording:
    """Eight seconds of a servo that is told steps at 50 Hz, simulated in steps of half a millisecond."""
    model, rng = mujoco.MjModel.from_xml_string(_BENCH), np.random.default_rng(1)
    model.opt.timestep = _STEP
    data, time = mujoco.MjData(model), np.arange(8 * _RATE) / _RATE
    levels = np.concatenate([[0.0], rng.uniform(-1.2, 1.2, 60)])
    told = levels[np.searchsorted(np.cumsum(rng.uniform(0.5, 1.3, 60)), time)]
    seen = np.zeros(len(time))
    for k in range(len(time)):
        seen[k] = data.qpos[0] + 2e-4 * rng.standard_normal()
        for j in range(round(1.0 / _RATE / _STEP)):
            at = int(np.floor((time[k] + j * _STEP - _DELAY) * _RATE + 1e-9))
            data.ctrl[0] = told[max(at, 0)]
            mujoco.mj_step(model, data)
    channels = (Channel("command", ("horn",), "rad", time, told), Channel("position", ("horn",), "rad", time, seen))
    return Recording("jumps", {c.name: c.replace(values=c.values.reshape(-1, 1)) for c in channels})


def test_a_delay_is_known_to_a_step_where_jumps_saturate_the_drive(tmp_path: Path) -> None:
    (tmp_path / "bench.xml").write_text(_BENCH)
    (tmp_path / "delay.toml").write_text('[[parameter]]\nquantity = "delay"\ntie = "all"\nlower = 0.0\nupper = 0.1\n')
    ready = prepare(tmp_path / "bench.xml", [_jumps()], parameters=tmp_path / "delay.toml", refuse=["zero"])
    (delay,) = ready.calibrate().estimates
    assert delay.low < _DELAY < delay.high
    assert delay.high - delay.low < 0.01, "and no worse than that"
