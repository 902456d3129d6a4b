# SPDX-License-Identifier: Apache-2.0
"""A structure that the robot has and the model lacks is noticed, and nothing is called identified that stands for it."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.calibration import Calibration
from trueup.errors import CalibrationError, SimulationFailedError
from trueup.loop.calibrate import Options
from trueup.loop.fit import DESCENT, SHIPPED, fit
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording
from trueup.trial import Trial

Array = NDArray[np.float64]

ARM = """
<mujoco><compiler angle="radian"/><option timestep="{step}" integrator="implicitfast"/><worldbody>
<body name="drive"><joint name="j" axis="0 1 0" range="-3 3" damping=".3" frictionloss="{friction}" armature="{armature}"/>
  <inertial pos="0 0 -.001" mass=".02" diaginertia="1e-5 1e-5 1e-5"/>
  <body name="arm">{gear}<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" mass="1.5"/></body></body></worldbody>
<actuator><position name="j" joint="j" kp="{kp}" kv="1.5"/></actuator></mujoco>
"""
SPRUNG = ARM.replace('range="-3 3"', 'range="-3 3" stiffness="30" springref="0.1"')
GEAR = '<joint name="gear" axis="0 1 0" stiffness="400" damping="0.3"/>'
TRUTH = {"kp": 60.0, "friction": 0.15, "armature": 0.012}
FILE = {"kp": 40.0, "friction": 0.3, "armature": 0.03}
TIME = np.arange(0.0, 4.0, 0.01)
NOISE = 2e-4  # rad


def calibrated(
    folder: Path,
    gear: str,
    more: str = "",
    truth: str = ARM,
    time: Array = TIME,
    lacking: bool | None = None,
    step: float | None = None,
) -> Calibration:
    """The arm without a gear, fitted to motions of one with `gear` (and otherwise as `truth`), both at a `step` in s: by
    default a coarse one, or one that bears the swing of a gear.
    """
    rng, step = np.random.default_rng(5), step or (0.0025 if gear else 0.005)
    (folder / "truth.xml").write_text(truth.format(gear=gear, step=step, **TRUTH))
    (folder / "arm.xml").write_text(ARM.format(gear="", step=step, **FILE))
    lines = "".join(f'[[parameter]]\nquantity = "{q}"\nof = "*"\n' for q in TRUTH) + more
    (folder / "parameters.toml").write_text(lines)
    robot = prepare(folder / "truth.xml", (), propose=False).simulator
    recordings = []
    for name in ("one", "two"):
        waves = [a * np.sin(2 * np.pi * f * time + p) for a, f, p in
                 zip((0.4, 0.2, 0.1, 0.05), (0.3, 0.8, 1.9, 4.0), rng.uniform(0, 6, 4), strict=True)]  # fmt: skip
        command = Channel("command", ("j",), "rad", time, np.sum(waves, axis=0)[:, None])
        run = Recording(name, {"command": command, "position": command.replace(name="position")})
        (seen,) = robot.rollout([Trial.of(run)], np.zeros((1, 0)))
        measured = seen.channels["position"][0] + rng.normal(0.0, NOISE, (len(time), 1))
        recordings.append(
            Recording(name, {"command": command, "position": Channel("position", ("j",), "rad", time, measured)})
        )
    return prepare(folder / "arm.xml", recordings, parameters=folder / "parameters.toml").calibrate(
        Options(cross_validate=False, lacking=lacking, stages=DESCENT)
    )


def test_a_gear_that_twists_is_noticed_and_the_rotor_that_stands_for_it_is_not_called_identified(
    tmp_path: Path,
) -> None:
    found = calibrated(tmp_path, GEAR)
    known = {e.name.rpartition(".")[2]: e for e in found.estimates}
    rotor = known["armature"]
    assert abs(rotor.value - TRUTH["armature"]) > 0.2 * TRUTH["armature"], "the case shows nothing otherwise"
    assert rotor.verdict == "effective"
    assert rotor.low <= TRUTH["armature"] <= rotor.high
    assert "replayed better with play and twist of gears" in found.lacking
    assert "may stand for something else that is wrong" in found.lacking
    again = calibrated(tmp_path, GEAR, '[[parameter]]\nquantity = "gear_compliance"\nof = "j"\nnominal = 0.001\n')
    known = {e.name.rpartition(".")[2]: e for e in again.estimates}
    assert known["gear_compliance"].value == pytest.approx(1.0 / 400.0, rel=0.2)
    assert known["armature"].value == pytest.approx(TRUTH["armature"], rel=0.05)
    assert "twist" not in again.lacking


def test_recordings_of_more_than_a_minute_are_asked_what_is_missing_where_that_is_wanted(tmp_path: Path) -> None:
    long = np.arange(0.0, 31.0, 0.02)
    quick = calibrated(tmp_path, GEAR, time=long, step=0.005)
    assert not quick.lacking
    assert any("60 s long" in note or "62 s long" in note for note in quick.notes)
    rotor = next(e for e in quick.estimates if e.name.endswith("armature"))
    assert abs(rotor.value - TRUTH["armature"]) > 0.2 * TRUTH["armature"], "the case shows nothing otherwise"
    assert rotor.verdict == "effective"
    assert "identified" not in {e.verdict for e in quick.estimates}
    assert "springs at the joints" in calibrated(tmp_path, "", truth=SPRUNG, time=long, lacking=True).lacking


def test_no_recording_is_asked_what_is_missing_where_that_is_refused(tmp_path: Path) -> None:
    refused = calibrated(tmp_path, GEAR, time=TIME[TIME < 3.0], lacking=False)
    assert not refused.lacking
    assert not any("what the model lacks" in note for note in refused.notes)


@pytest.mark.parametrize("error", [SimulationFailedError, CalibrationError])
def test_nominal_values_that_cannot_be_simulated_are_no_place_to_look_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: type[Exception]
) -> None:
    def failing(*given: object, stages: object, **more: object) -> object:
        if stages is SHIPPED:
            raise error("the simulation fails at the start values")
        return fit(*given, stages=stages, **more)  # type: ignore[arg-type]

    monkeypatch.setattr("trueup.loop.missing.fit", failing)
    monkeypatch.setattr("trueup.loop.missing.explained", lambda residual: False)  # as if nothing that was found did
    assert "play and twist of gears" in calibrated(tmp_path, GEAR).lacking


def test_nothing_is_missed_where_the_model_has_the_robots_structure(tmp_path: Path) -> None:
    found = calibrated(tmp_path, "")
    assert not found.lacking
    for e in found.estimates:
        assert e.verdict in ("identified", "tied")
        assert e.low <= TRUTH[e.name.rpartition(".")[2]] <= e.high


def test_a_spring_that_the_model_lacks_is_named_and_once_declared_it_is_found_and_written(tmp_path: Path) -> None:
    found = calibrated(tmp_path, "", truth=SPRUNG)
    assert "replayed better with springs at the joints, which the model lacks: j.spring" in found.lacking
    size, rest = (float(found.lacking.partition(f"{name} ")[2].split()[0]) for name in ("j.spring", "j.spring_rest"))
    assert (size, rest) == (pytest.approx(30.0, rel=0.2), pytest.approx(0.1, rel=0.2))
    more = "".join(f'[[parameter]]\nquantity = "{q}"\nof = "j"\n' for q in ("spring", "spring_rest"))
    again = calibrated(tmp_path, "", more, truth=SPRUNG, lacking=False)
    known = {e.name.rpartition(".")[2]: e for e in again.estimates}
    assert known["spring"].value == pytest.approx(30.0, rel=0.03)
    assert known["spring_rest"].value == pytest.approx(0.1, rel=0.03)
    ready = prepare(tmp_path / "arm.xml", (), parameters=tmp_path / "parameters.toml", propose=False)
    ready.write(again, tmp_path / "fitted.xml", tmp_path / "fitted.toml")
    written = mujoco.MjModel.from_xml_path(str(tmp_path / "fitted.xml"))
    assert written.jnt_stiffness[0] == pytest.approx(known["spring"].value)
    assert written.qpos_spring[0] == pytest.approx(known["spring_rest"].value)


def test_a_cable_that_stiffens_is_named_beside_its_spring_and_once_declared_it_is_found_and_written(
    tmp_path: Path,
) -> None:
    """Stiffness 20 N m/rad that grows by 100 N m/rad3 times the square of the way from 0.1 rad."""
    cable = ARM.replace('range="-3 3"', 'range="-3 3" stiffness="20 0 100" springref="0.1"')
    several = ("spring", "spring_rest", "spring_cubic")
    lines = [f'[[parameter]]\nquantity = "{q}"\nof = "j"\n' for q in several]
    found = calibrated(tmp_path, "", "".join(lines[:2]), truth=cable)
    assert "replayed better with springs that stiffen, which the model lacks: j.spring_cubic" in found.lacking
    again = calibrated(tmp_path, "", "".join(lines), truth=cable, lacking=False)
    known = {e.name.rpartition(".")[2]: e for e in again.estimates}
    for name, value in zip(several, (20.0, 0.1, 100.0), strict=True):
        assert known[name].low <= value <= known[name].high
        assert known[name].value == pytest.approx(value, rel=0.05)
    ready = prepare(tmp_path / "arm.xml", (), parameters=tmp_path / "parameters.toml", propose=False)
    ready.write(again, tmp_path / "fitted.xml", tmp_path / "fitted.toml")
    written = mujoco.MjModel.from_xml_path(str(tmp_path / "fitted.xml"))
    assert written.jnt_stiffnesspoly[0, 1] == pytest.approx(known["spring_cubic"].value)


TWO = """
<mujoco><compiler angle="radian"/><option timestep=".005" integrator="implicitfast"/>
<default><joint axis="0 1 0" damping=".3"/></default>
<worldbody><body><joint name="shoulder" frictionloss="{friction}" armature="{armature}"/>
  <inertial pos="0.2 0 0" mass="2" diaginertia=".01 .02 .02"/>
  <body name="fore" pos="0.4 0 0"><joint name="elbow" frictionloss="{friction}" armature="{armature}"/>
    <inertial pos="0.15 0 0" mass="{mass}" diaginertia=".003 .008 .008"/></body></body></worldbody>
<actuator><position joint="shoulder" kp="{kp}" kv="3"/><position joint="elbow" kp="{kp}" kv="1.5"/></actuator></mujoco>
"""


def test_a_link_that_is_heavier_than_its_file_is_named(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    (tmp_path / "truth.xml").write_text(TWO.format(mass=1.4, **TRUTH))
    (tmp_path / "arm.xml").write_text(TWO.format(mass=1.0, **FILE))
    robot, recordings, joints = prepare(tmp_path / "truth.xml", (), propose=False).simulator, [], ("shoulder", "elbow")
    for name in ("one", "two"):
        phases = rng.uniform(0, 6, (2, 3))
        waves = [sum(a * np.sin(2 * np.pi * f * TIME + p) for a, f, p in zip((0.5, 0.3, 0.1), (0.25, 0.7, 2.1), own,
                                                                             strict=True)) for own in phases]  # fmt: skip
        command = Channel("command", joints, "rad", TIME, np.stack(waves, axis=1))
        run = Recording(name, {"command": command, "position": command.replace(name="position")})
        (seen,) = robot.rollout([Trial.of(run)], np.zeros((1, 0)))
        measured = seen.channels["position"][0] + rng.normal(0.0, NOISE, (len(TIME), 2))
        recordings.append(run.with_channel(command.replace(name="position", values=measured)))
    lines = "".join(f'[[parameter]]\nquantity = "{q}"\nof = "*"\n' for q in ("friction", "armature", "kp"))
    (tmp_path / "parameters.toml").write_text(lines)
    ready = prepare(tmp_path / "arm.xml", recordings, parameters=tmp_path / "parameters.toml")
    found = ready.calibrate(Options(cross_validate=False, stages=DESCENT))
    assert "links of another mass or balance, which the model lacks: fore.mass" in found.lacking
    assert float(found.lacking.partition("fore.mass ")[2].split()[0]) == pytest.approx(1.4, rel=0.05)
    for e in found.estimates:
        assert e.verdict != "identified" or e.low <= TRUTH[e.name.rpartition(".")[2]] <= e.high


CARRYING = """
<mujoco><option timestep=".005" integrator="implicitfast"/><worldbody>
<body name="upper"><joint name="a" axis="0 1 0" damping="1" frictionloss=".5" armature=".1"/>
  <inertial pos="0 0 .13" mass="2.6" diaginertia=".02 .02 .004"/>
  <body name="fore" pos="0 0 .3"><joint name="b" axis="0 1 0" damping=".6" frictionloss=".3" armature=".06"/>
    <inertial pos="0 0 .1" mass="1.4" diaginertia=".008 .008 .002"/>
    <body name="payload" pos="0 0 .3"><inertial pos="0 0 0" mass="{load}" diaginertia="{spread} {spread} {spread}"/></body>
</body></body>
</worldbody><actuator><position name="a" joint="a" kp="{a}" kv="8"/><position name="b" joint="b" kp="{b}" kv="4"/></actuator>
</mujoco>"""


def test_a_payload_of_which_the_file_has_next_to_nothing_is_named_with_its_mass(tmp_path: Path) -> None:
    (tmp_path / "truth.xml").write_text(CARRYING.format(load=2.4, spread=0.012, a=160, b=75))
    (tmp_path / "arm.xml").write_text(CARRYING.format(load=0.2, spread=0.001, a=120, b=80))
    (tmp_path / "own.toml").write_text(
        "".join(f'[[parameter]]\nquantity = "{q}"\nof = "*"\n' for q in ("kp", "kv", "friction"))
    )
    robot, rng, time = prepare(tmp_path / "truth.xml", (), propose=False).simulator, np.random.default_rng(5), TIME[::2]
    waves = [0.5 + 0.5 * np.sin(2.0 * np.pi * f * time + p) for f, p in ((0.4, 1.0), (0.9, 2.0))]
    command = Channel("command", ("a", "b"), "rad", time, np.stack(waves, axis=1))
    run = Recording("one", {"command": command, "position": command.replace(name="position")})
    (seen,) = robot.rollout([Trial.of(run)], np.zeros((1, 0)))
    measured = seen.channels["position"][0] + rng.normal(0.0, NOISE, (len(time), 2))
    log = Recording("one", {"command": command, "position": Channel("position", ("a", "b"), "rad", time, measured)})
    ready = prepare(tmp_path / "arm.xml", [log], parameters=tmp_path / "own.toml", refuse=["zero"])
    found = ready.calibrate(Options(cross_validate=False, stages=DESCENT))
    assert "payload.mass 2.4" in found.lacking
    assert all(e.low < true < e.high for e, true in zip(found.estimates[:2], (160.0, 75.0), strict=True))
