# SPDX-License-Identifier: Apache-2.0
"""Drives whose rotor, behind a screw or a gear, is heavier than all that they move."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

import trueup
from trueup.calibration import Calibration
from trueup.loop.calibrate import Options
from trueup.recording import Channel, Recording

LIFT = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body>
<joint name="lift" type="slide" axis="0 0 1" range="-0.3 0.3" {joint}/>
<inertial pos="0 0 0" mass="1.1" diaginertia=".01 .01 .01"/>
</body></worldbody><actuator><position name="lift" joint="lift" kp="{kp}" kv="{kv}"/></actuator></mujoco>"""
ROTOR, KP, KV, FRICTION = 12.0, 60e3, 2400.0, 18.0  # kg; N/m; N s/m; N


def _moves(name: str, seed: int) -> Recording:
    """8 s of moves from point to point, 3 um of noise."""
    model = mujoco.MjModel.from_xml_string(
        LIFT.format(joint=f'armature="{ROTOR}" frictionloss="{FRICTION}"', kp=KP, kv=KV)
    )
    data, rng, rows = mujoco.MjData(model), np.random.default_rng(seed), []
    points = np.concatenate([[0.0], rng.uniform(-0.1, 0.1, 9)])
    for k in range(4000):
        t = 0.002 * k
        share = min(t % 1.0 / 0.4, 1.0)
        way = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        data.ctrl[0] = points[int(t)] + (points[int(t) + 1] - points[int(t)]) * way
        if k % 4 == 0:
            rows.append((t, data.ctrl[0], data.qpos[0] + 3e-6 * rng.standard_normal()))
        mujoco.mj_step(model, data)
    time, command, position = np.array(rows).T
    return Recording(
        name,
        {
            "command": Channel("command", ("lift",), "m", time, command[:, None]),
            "position": Channel("position", ("lift",), "m", time, position[:, None]),
        },
    )


def _found(folder: Path) -> Calibration:
    (folder / "lift.xml").write_text(LIFT.format(joint="", kp=8000, kv=300))
    ready = trueup.prepare(folder / "lift.xml", [_moves("one", 1)])
    return ready.calibrate(options=Options(cross_validate=False, lacking=False))


def test_the_stiffness_of_a_lift_is_not_called_known_where_its_screw_is_not(tmp_path: Path) -> None:
    found = {e.name: e for e in _found(tmp_path).estimates}
    for name, truth in (("lift.kp", KP), ("lift.kv", KV), ("lift.friction", FRICTION)):
        assert found[name].low <= truth <= found[name].high
        assert found[name].verdict in ("weak", "tied")
