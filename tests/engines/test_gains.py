# SPDX-License-Identifier: Apache-2.0
"""Logs of a servo at several of its own gains: one stiffness explains them all."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.arrays import Array
from trueup.articulated.gains import Gains
from trueup.calibration import Calibration
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.inspection.settings import setting
from trueup.loop.calibrate import Options
from trueup.loop.prepare import Preparation, prepare, simulator_for
from trueup.recording import Channel, Recording

_PENDULUM = """
<mujoco><option timestep="0.002" integrator="implicitfast"/>
  <worldbody><body><joint name="arm" axis="0 1 0" damping="0.04" frictionloss="0.02" armature="0.001"/>
    <inertial pos="0 0 -0.1" mass="0.5" diaginertia="2e-4 2e-4 2e-4"/></body></worldbody>
  <actuator><position name="arm" joint="arm" kp="{kp}"/></actuator></mujoco>
"""
_PER_UNIT = 0.0021  # N m/rad of each unit of the servo's own gain


def _log(setting: float, kind: str, name: str) -> Recording:
    model = mujoco.MjModel.from_xml_string(_PENDULUM.format(kp=_PER_UNIT * setting))
    data = mujoco.MjData(model)
    time = np.arange(0.0, 4.0, 0.01)
    command = np.sin(2.0 * time) if kind == "sine" else np.where(time % 2.0 < 1.0, 0.8, -0.2)
    position = []
    for wanted in command:
        position.append(float(data.qpos[0]))
        data.ctrl[:] = wanted
        mujoco.mj_step(model, data, 5)
    noisy = np.array(position) + np.random.default_rng(int(setting)).normal(0.0, 5e-4, len(time))
    channels = {n: Channel(n, ("arm",), "rad", time, v) for n, v in (("command", command), ("position", noisy))}
    return Recording(name, channels, {"kp": f"{setting:g}"})


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "pendulum.xml"
    path.write_text(_PENDULUM.format(kp=1.0).replace('damping="0.04" frictionloss="0.02" armature="0.001"', ""))
    return path


def _fitted(model: Path, logs: Sequence[Recording], held: Sequence[Recording]) -> tuple[Preparation, Calibration]:
    ready = prepare(model, logs, held)
    return ready, ready.calibrate(Options(cross_validate=False))


def test_a_gain_that_was_never_fitted_is_replayed_nearly_to_the_noise(model: Path, tmp_path: Path) -> None:
    logs = [_log(100.0, "sine", "soft"), _log(400.0, "steps", "stiff")]
    ready, found = _fitted(model, logs, [_log(200.0, "steps", "between")])
    (between,) = found.held_out()
    assert np.std(between.after - between.measured) < 3e-3
    assert any("100, 200, 400" in note for note in ready.notes)
    (kp,) = [e for e in found.estimates if e.name == "arm.kp"]
    assert kp.value == pytest.approx(400.0 * _PER_UNIT, rel=0.03)
    # The file says for which gain it holds: alone with a log at another one it still replays it.
    ready.family.write(ready.simulator, found, tmp_path / "fit.xml", tmp_path / "parameters.toml")
    again, _ = simulator_for(tmp_path / "fit.xml", [_log(200.0, "sine", "soft alone")])
    assert isinstance(again, MujocoSimulator)
    assert again.gains.factor("kp", "soft alone", "arm") == pytest.approx(0.5)
    again, _ = simulator_for(model, [_log(200.0, "sine", "soft alone")], tmp_path / "parameters.toml")
    assert isinstance(again, MujocoSimulator)
    assert again.gains.factor("kp", "soft alone", "arm") == pytest.approx(0.5)


def test_logs_of_which_one_names_no_gain_are_taken_as_one_servo(model: Path) -> None:
    silent = replace(_log(400.0, "steps", "stiff"), provenance={})
    simulator, notes = simulator_for(model, [_log(100.0, "sine", "soft"), silent])
    assert isinstance(simulator, MujocoSimulator)
    assert simulator.gains.factor("kp", "soft", "arm") == 1.0
    assert any("only some recordings name the gain" in note and "'kp'" in note and "stiff" in note for note in notes)


def test_gains_in_si_units_tell_what_the_masses_are_wrong_by(model: Path) -> None:
    heavy = _log(400.0, "sine", "told").replace(provenance={"kp": f"{400.0 * _PER_UNIT / 0.75:g}"})
    counts = _log(400.0, "sine", "counted")
    ready, found = _fitted(model, [heavy], [])  # the file has three quarters of the weight, by its log's 1.12 N m/rad
    (note,) = [n for n in ready.family.advice(ready.simulator, found) if "in proportion to the masses" in n]
    (times,) = re.findall(r"kp that the log names are ([\d.]+) times those found: if they are in N m/rad", note)
    assert float(times) == pytest.approx(4.0 / 3.0, rel=0.02)
    other = prepare(model, [counts])
    (note,) = [n for n in other.family.advice(other.simulator, found) if "in proportion to the masses" in n]
    assert "times those found" not in note


def _with_settings(log: Recording, kp: Sequence[float] | Array, kd: Sequence[float], name: str = "") -> Recording:
    """A log that has two joints' gains in columns of their own."""
    time, rows = log.time, len(log.time)
    gains = {
        n: Channel(n, ("arm", "hand"), "", time, np.broadcast_to(v, (rows, 2))) for n, v in (("kp", kp), ("kd", kd))
    }
    return log.replace(name=name or log.name, channels={**log.channels, **gains}, provenance={})


def test_each_joint_follows_its_own_gains() -> None:
    log = _log(100.0, "sine", "soft")
    soft, stiff = _with_settings(log, (20.0, 30.0), (0.5, 0.0)), _with_settings(log, (60.0, 30.0), (1.0, 0.0), "stiff")
    gains, notes = Gains.named_by([soft, stiff], shipped={"kp.arm": 20.0})
    assert gains.given_for == {"kp.arm": 20.0, "kp.hand": 30.0, "kv": 1.0}
    assert [gains.factor("kp", "stiff", joint) for joint in ("arm", "hand")] == [3.0, 1.0]
    assert [gains.factor("kv", "soft", joint) for joint in ("arm", "hand")] == [0.5, 1.0]
    assert any("of arm (20, 60)" in note for note in notes)
    # A log of other gains that comes later is replayed by those, though it is alone.
    later, _ = Gains.named_by([_with_settings(log, (60.0, 60.0), (1.0, 0.0))], gains.given_for)
    assert [later.factor("kp", "soft", joint) for joint in ("arm", "hand")] == [3.0, 2.0]


def test_a_joint_whose_gain_is_zero_beside_others_is_not_held_by_its_servo() -> None:
    log = _log(100.0, "sine", "soft")
    gains, notes = Gains.named_by([_with_settings(log, (20.0, 0.0), (0.5, 0.0))])
    assert [gains.factor("kp", "soft", joint) for joint in ("arm", "hand")] == [1.0, 0.0]
    assert any("gains of hand are 0" in note for note in notes)
    nothing, _ = Gains.named_by([_with_settings(log, (0.0, 0.0), (0.0, 0.0))])
    assert nothing.factor("kp", "soft", "arm") == 1.0


def test_a_log_whose_gains_are_switched_on_late_is_taken_from_there_on(model: Path) -> None:
    log = _log(100.0, "sine", "late")
    kp = np.where(log.time < 1.0, 0.0, 20.0)[:, None]
    late = _with_settings(log, np.hstack([kp, kp]), (0.5, 0.5))
    ready = prepare(model, [late])
    assert ready.recordings[0].start == pytest.approx(1.0)
    assert [d.name for d in ready.diagnoses if "0 ... 20" in str(d)] == ["gains"]
    assert prepare(model, [late], refuse=["gains"]).recordings[0].start == 0.0


def test_gains_are_facts_in_a_list_or_by_joint_too() -> None:
    log = _log(100.0, "sine", "soft")
    two = log.replace(channels={n: c.replace(labels=("arm", "hand"), values=np.hstack([c.values] * 2))
                                for n, c in log.channels.items()})  # fmt: skip
    for facts in ({"gains.kp": "[20, 30.0]"}, {"kp.arm": "20", "kp.hand": "30"}, {"arm/kp": "20", "hand/kp": "30"}):
        assert setting(two.replace(provenance=facts), "kp") == {"arm": 20.0, "hand": 30.0}
    assert setting(two.replace(provenance={"servo.kp": "400"}), "kp") == {"": 400.0}


def test_a_battery_that_goes_down_within_a_log_is_named(model: Path) -> None:
    log = _log(400.0, "sine", "long")
    rng, left = np.random.default_rng(0), np.linspace(1.0, 0.82, len(log.time))
    volts = 12.4 * left + rng.normal(0.0, 0.05, len(left))
    volts[::40] -= 2.0  # what a start of all drives takes for a moment
    battery = Channel("voltage", ("battery",), "V", log.time, volts[:, None])
    sags = log.with_channel(battery)
    assert any("voltage changes within recordings ('long' 12.3 to 10.1)" in n for n in prepare(model, [sags]).notes)
    steady = log.with_channel(battery.replace(values=(volts / left)[:, None]))
    assert not any("voltage" in note for note in prepare(model, [steady]).notes)


def test_logs_at_other_supply_voltages_are_said_to_be(model: Path) -> None:
    log = _log(100.0, "sine", "weak").replace(provenance={"vin": "7.4"})
    volts = Channel("voltage", ("voltage",), "V", log.time, np.full((len(log.time), 1), 12.1))
    strong = log.replace(name="strong", provenance={}).with_channel(volts)
    assert any("7.4 ('weak') to 12.1 ('strong')" in note for note in prepare(model, [log, strong]).notes)
    same = log.replace(name="same", provenance={"vin": "7.9"})
    assert not any("voltage" in note for note in prepare(model, [log, same]).notes)


def test_recordings_that_come_later_have_gains_of_their_own(model: Path) -> None:
    logs = [_log(100.0, "sine", "soft"), _log(400.0, "steps", "stiff")]
    later = prepare(model, logs).with_recordings([*logs, _log(200.0, "sine", "between")])
    assert isinstance(later.simulator, MujocoSimulator)
    assert [later.simulator.gains.factor("kp", name, "arm") for name in ("soft", "between", "stiff")] == [
        0.25,
        0.5,
        1.0,
    ]
