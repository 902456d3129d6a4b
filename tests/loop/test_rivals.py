# SPDX-License-Identifier: Apache-2.0
"""What hangs on a structure that a short log neither asks for nor rules out is not called identified."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trueup.calibration import Estimate
from trueup.loop.calibrate import Options
from trueup.loop.prepare import prepare
from trueup.loop.rivals import Rival, doubted, widened
from trueup.parameters import Parameter
from trueup.recording import Channel, Recording
from trueup.trial import Trial

ARM = """
<mujoco><compiler angle="radian"/><option integrator="implicitfast"/><worldbody>
<body name="drive"><joint name="j" axis="0 1 0" range="-3 3" damping=".3" frictionloss="{friction}" armature="{armature}"/>
  <inertial pos="0 0 -.001" mass=".02" diaginertia="1e-5 1e-5 1e-5"/>
  <body name="arm"><geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" mass="1.5"/></body></body></worldbody>
<actuator><position name="j" joint="j" kp="{kp}" kv="1.5"/></actuator></mujoco>
"""
TRUTH = {"kp": 60.0, "friction": 0.15, "armature": 0.012}
FILE = {"kp": 40.0, "friction": 0.3, "armature": 0.03}
NOISE = 1e-3  # rad


def rotor(folder: Path, seconds: float, rates: tuple[float, ...]) -> Estimate:
    """The arm's rotor from one log of sines with these frequencies."""
    rng = np.random.default_rng(3)
    (folder / "truth.xml").write_text(ARM.format(**TRUTH))
    (folder / "arm.xml").write_text(ARM.format(**FILE))
    robot = prepare(folder / "truth.xml", (), propose=False).simulator
    time = np.arange(0.0, seconds, 0.01)
    told = sum(0.4 / (k + 1) * np.sin(2.0 * np.pi * rate * time) for k, rate in enumerate(rates))
    command = Channel("command", ("j",), "rad", time, np.asarray(told)[:, None])
    still = command.replace(name="position", values=np.zeros((len(time), 1)))
    plan = Recording("log", {"command": command, "position": still})
    (seen,) = robot.rollout([Trial.of(plan)], robot.parameters.nominal[None])
    log = plan.with_channel(
        still.replace(values=seen.channels["position"][0] + rng.normal(0.0, NOISE, still.values.shape))
    )
    lines = "".join(f'[[parameter]]\nquantity = "{q}"\nof = "*"\n' for q in TRUTH)
    (folder / "parameters.toml").write_text(lines)
    ready = prepare(folder / "arm.xml", [log], parameters=folder / "parameters.toml")
    found = ready.calibrate(Options(cross_validate=False))
    return next(e for e in found.estimates if e.name == "j.armature")


def test_a_rotor_that_slow_motion_does_not_tell_from_a_gear_that_twists_is_identified_by_fast_motion_alone(
    tmp_path: Path,
) -> None:
    slow, fast = rotor(tmp_path, 2.0, (0.3,)), rotor(tmp_path, 3.0, (0.7, 2.1, 4.0))
    assert slow.verdict == "weak"
    assert "hangs on whether the robot has play and twist of gears, which these recordings do not tell" in slow.note
    assert "would show it" in slow.note
    assert fast.verdict in ("identified", "tied")
    for e in (slow, fast):
        assert e.low <= TRUTH["armature"] <= e.high


def test_a_rival_widens_what_it_moves_and_takes_its_verdict_where_that_is_much() -> None:
    much = Estimate("a", "N m", 1.0, 2.0, 1.9, 2.1, 0.0, 9.0, True, "identified")
    little = replace(much, name="b")
    asked = Parameter("j.dead_band", "rad", 0.0, 0.0, 0.1, shown_by="slow reversals")
    rival = Rival("a dead band", asked, np.array([0.5, 0.05]), np.zeros(2))
    of = [rival, replace(rival, name="backlash", down=0.5 * rival.down)]
    first, second = doubted(widened([much, little], of), of)
    assert (first.verdict, second.verdict) == ("weak", "identified")
    assert first.low == pytest.approx(2.0 - np.hypot(0.1, 0.5))
    assert second.low == pytest.approx(2.0 - np.hypot(0.1, 0.05))
    assert first.high == second.high == pytest.approx(2.1)
    assert "whether the robot has a dead band" in first.note
