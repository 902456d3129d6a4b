# SPDX-License-Identifier: Apache-2.0
"""Legs of a robot whose base is held feel nothing of one another: fewer simulations tell what each of many rows does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.articulated.declarations import Declaration, declare
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.mujoco.run import Run
from trueup.engines.simulator import Simulator
from trueup.recording import Channel, Recording
from trueup.trial import Trial

Array = NDArray[np.float64]

LEG = """<body name="{n}_thigh" pos="0 {y} 1"><joint name="{n}_hip" axis="0 1 0" frictionloss="0.1"/>
<geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.2" mass="0.5" contype="{touch}" conaffinity="{touch}"/>
<body name="{n}_shank" pos="0 0 -0.2"><joint name="{n}_knee" axis="0 1 0" damping="0.05"/>
<geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.2" mass="0.3" contype="{touch}" conaffinity="{touch}"/></body></body>"""
JOINTS = [f"{leg}_{joint}" for leg in ("left", "right") for joint in ("hip", "knee")]
LINES = [
    Declaration("kp"), Declaration("friction"), Declaration("armature", nominal=0.01), Declaration("zero"),
    Declaration("friction_static", nominal=0.1), Declaration("mass", ("left_shank",)), Declaration("mass", ("right_shank",)),
    Declaration("delay", tie="all"),
]  # fmt: skip


def robot(folder: Path, *, gap: float = 0.4, touch: int = 0) -> MujocoSimulator:
    legs = LEG.format(n="left", y=0.0, touch=touch) + LEG.format(n="right", y=gap, touch=touch)
    servos = "".join(f'<position name="{j}" joint="{j}" kp="20" kv="1"/>' for j in JOINTS)
    path = folder / "legs.xml"
    path.write_text(f"<mujoco><worldbody>{legs}</worldbody><actuator>{servos}</actuator></mujoco>")
    model = load(path)
    return MujocoSimulator(model, *declare(model, LINES))


def recorded() -> Trial:
    time = np.arange(0.0, 1.0, 0.01)
    told = 0.5 * np.sin(time[:, None] * np.array([3.0, 5.0, 7.0, 9.0]))
    channels = {n: Channel(n, tuple(JOINTS), "rad", time, told) for n in ("command", "position")}
    return Trial.of(Recording("r", channels), ("position",))


def around(simulator: Simulator) -> Array:
    """A point and those beside it along each parameter, as for a Jacobian."""
    space = simulator.parameters
    unit = np.clip(space.to_unit(space.nominal), 0.3, 0.7)
    return space.from_unit(np.concatenate([unit[None], unit + 0.1 * np.eye(len(unit))]))


def simulated(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Rows of each run from now on."""
    rows, whole = list[int](), Run.__init__

    def counted(run: Run, simulator: object, trials: object, values: Array, *more: object) -> None:
        rows.append(len(values))
        whole(run, simulator, trials, values, *more)  # type: ignore[arg-type]

    monkeypatch.setattr(Run, "__init__", counted)
    return rows


def test_rows_move_as_each_would_by_itself_in_half_the_simulations(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulator, trial = robot(tmp_path), recorded()
    values = around(simulator)
    alone = np.concatenate([simulator.rollout([trial], row[None])[0].channels["position"] for row in values])
    rows = simulated(monkeypatch)
    (together,) = simulator.rollout([trial], values)
    np.testing.assert_allclose(together.channels["position"], alone, atol=1e-9)
    assert len(values) == 24
    assert rows == [13]  # the point, eleven parameters of each leg, and the delay that they share


def test_a_leg_that_blows_up_fails_its_own_row_alone(tmp_path: Path) -> None:
    simulator, trial = robot(tmp_path), recorded()
    values = around(simulator)
    wild = 1 + simulator.parameters.index("left_knee.kp")
    values[wild, wild - 1] = -1e9
    (together,) = simulator.rollout([trial], values)
    assert set(together.failures) == {wild}
    (alone,) = simulator.rollout([trial], values[[wild + 2]])
    np.testing.assert_allclose(together.channels["position"][wild + 2], alone.channels["position"][0], atol=1e-9)
    assert np.isfinite(np.delete(together.channels["position"], wild, axis=0)).all()


def test_legs_that_touch_are_simulated_as_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    simulator, trial = robot(tmp_path, gap=0.03, touch=1), recorded()
    values = around(simulator)
    rows = simulated(monkeypatch)
    simulator.rollout([trial], values)
    assert rows == [len(values)]


def test_what_touches_nothing_is_known_of_the_same_robot_with_further_parameters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulator, trial = robot(tmp_path, touch=1), recorded()
    simulator.rollout([trial], simulator.parameters.nominal[None])
    further, rows = next(iter(simulator.structures().values())), simulated(monkeypatch)
    further.rollout([trial], around(further))
    assert rows[0] < len(around(further))  # packed at once, and not first with contacts
