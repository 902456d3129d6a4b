# SPDX-License-Identifier: Apache-2.0
"""A simulated servo of hidden truth is found again; what an experiment cannot tell is said."""

from __future__ import annotations

import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import trueup
from trueup.actuators.actuator import mjcf_text, replay_file
from trueup.actuators.bench import Bench, runs_of
from trueup.actuators.experiment import experiment
from trueup.actuators.fit import Problem, Slopes, coarseness, fit
from trueup.actuators.identify import Actuator, identify_actuator
from trueup.actuators.output import output_of
from trueup.actuators.replay import replay
from trueup.actuators.servo import Law
from trueup.cli import main
from trueup.errors import ParameterError, RecordingError, UnknownNameError
from trueup.formats import write
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Recording
from trueup.units import GRAVITY

sys.path.insert(0, str(Path(__file__).parent))
from servo_bench import BENCH, logged

TRUTH = Law(1.5, 2e-3, 0.05, 0.02, load_motor=0.2, load_external=0.15, voltage_limit=0.9)
PAGE = Path(__file__).resolve().parents[2] / "docs" / "actuators.md"


def recordings(law: Law, kinds: tuple[str, ...] = ("steps", "sines", "drop"), bench: Bench = BENCH) -> list[Recording]:
    rng = np.random.default_rng(3)
    return [logged(law, kind, rng, seconds=3.0, bench=bench) for kind in kinds]


@pytest.fixture(scope="module")
def found() -> Actuator:
    held = logged(TRUTH, "chirp", np.random.default_rng(4), seconds=3.0)
    return identify_actuator(recordings(TRUTH), [held], bench=BENCH, ask=("voltage limit", "dead band", "delay"))


def test_the_structure_and_the_numbers_of_a_hidden_servo_are_found(found: Actuator) -> None:
    assert set(found.structures) == {"voltage limit", "friction under load"}
    assert any("a softer servo" in sentence for sentence in found.experiment.cannot)
    assert found.law is not None
    for name in ("stiffness", "armature", "back_emf", "coulomb", "load_motor", "load_external", "voltage_limit"):
        assert getattr(found.law, name) == pytest.approx(getattr(TRUTH, name), rel=0.1), name
    covered = [v.low <= getattr(TRUTH, v.name) <= v.high for v in found.values if v.name in Law._fields and v.value > 0]
    assert np.mean(covered) > 0.5


def test_a_pause_of_the_logger_parts_a_run() -> None:
    (whole,) = recordings(TRUTH, ("sines",))
    cut = {}
    for name, channel in whole.channels.items():
        kept = (channel.time < 1.0) | (channel.time > 2.0)
        cut[name] = channel.replace(time=channel.time[kept], values=channel.values[kept])
    seen = identify_actuator([whole.replace(channels=cut)], bench=Bench())
    assert [run.name for run in seen.runs] == ["sines part 1", "sines part 2"]
    assert any("has a pause" in note for note in seen.notes)
    assert not any("is taken to hold" in note for note in seen.notes)


def test_what_a_replays_steps_put_into_values_is_little_and_foretold() -> None:
    plain = Law(1.5, 2e-3, 0.05, 0.02)
    runs, _, _ = runs_of(recordings(plain, ("steps", "sines")), BENCH)  # simulated in steps of 0.5 ms
    ranges = {"stiffness": (0.3, 6.0), "armature": (5e-4, 8e-3), "back_emf": (0.01, 0.25), "coulomb": (5e-3, 0.1)}
    space = ParameterSpace(tuple(Parameter(n, "1", a, a, b, scale="log") for n, (a, b) in ranges.items()))
    truth = space.to_unit([getattr(plain, n) for n in space.names])

    def off(step: float, *, file: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """What values are off by, in shares of their ranges, and what is foretold of that."""
        problem = Problem(runs, step, file=file)
        fitted = fit(problem, space.parameters, {n: getattr(plain, n) for n in space.names})
        error = np.abs(space.to_unit([fitted.values[n] for n in space.names]) - truth)
        return error, coarseness(problem, fitted, Slopes.at(problem, fitted))

    assert off(4e-3)[0].max() < 0.1 * off(4e-3, file=True)[0].max()  # which MuJoCo damps at the speed after the step
    for step in (16e-3, 8e-3):
        error, told = off(step)
        worst = error.argmax()
        assert error[worst] > 0.004  # beyond the noise
        assert 0.4 * error[worst] < told[worst] < 2.5 * error[worst]


def test_a_motion_that_was_held_out_is_met_to_the_encoder(found: Actuator) -> None:
    assert found.error(held_out=True) < 4e-3
    assert found.error(held_out=True) < 0.3 * found.error(held_out=True, file=True)


def test_what_is_written_says_what_was_found(found: Actuator, tmp_path: Path) -> None:
    paths = found.write(tmp_path / "servo")
    assert sorted(p.name for p in paths) == ["actuator.json", "actuator.py", "actuator.xml"]
    plain = json.loads((tmp_path / "servo" / "actuator.json").read_text("utf-8"))
    assert found.law is not None
    assert plain["law"]["stiffness"] == found.law.stiffness
    assert plain["law"]["force_limit"] is None
    assert plain["mjcf"]["delay"] == 0.0


def test_a_limit_of_force_and_a_delay_that_were_found_are_in_the_file(tmp_path: Path) -> None:
    law = Law(2.0, 2e-3, 0.0, 0.02, viscous=0.05, force_limit=0.45, delay=0.014)
    held = logged(law, "chirp", np.random.default_rng(4), seconds=3.0)
    asked = ("force limit", "delay", "viscous friction")
    found = identify_actuator(recordings(law, ("steps", "sines", "slow")), [held], bench=BENCH, ask=asked)
    assert {"force limit", "delay"} <= set(found.structures)
    found.write(tmp_path)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "actuator.xml"))
    assert model.actuator_forcerange[0, 1] == pytest.approx(0.45, rel=0.03)
    assert model.actuator_delay[0] == pytest.approx(0.014, abs=2e-3)
    run = found.runs[-1]
    shown = float(np.mean(np.abs(replay_file(tmp_path / "actuator.xml", run) - run.position)))
    assert found.error(held_out=True, file=True) == pytest.approx(shown, rel=0.01)
    assert shown < 3e-3


def test_without_a_known_load_only_ratios_are_told() -> None:
    foot = Bench(inertia=1e-3, gravity=0.0)
    law = Law(2.0, 0.0, 0.1, 0.05)
    logs = recordings(law, ("sines", "chirp"), foot)
    unknown = identify_actuator(logs)
    assert unknown.law is None
    ratios = {v.name: v.value for v in unknown.experiment.ratios}
    assert ratios["kd / kp"] == pytest.approx(0.05, rel=0.1)
    assert ratios["kc / kp"] == pytest.approx(0.025, rel=0.15)
    assert "only their ratios are seen" in unknown.experiment.cannot[0]
    runs, _, _ = runs_of(logs, replace(foot, inertia=2e-3))  # twice the inertia: twice every gain
    assert experiment(runs).ratios == unknown.experiment.ratios


def test_a_heavy_pendulum_fixes_the_gains_in_newton_metres() -> None:
    law = Law(3.0, 0.0, 0.1, 0.03)
    runs, _, _ = runs_of(recordings(law, ("slow", "sines", "chirp")), BENCH)
    for value, true in zip(experiment(runs).gains, (3.0, 0.1, 0.03), strict=True):
        assert value.low < true < value.high, value
        assert value.value == pytest.approx(true, rel=0.15)


def test_a_duty_channel_shows_where_it_ends() -> None:
    (run,), _, _ = runs_of(recordings(TRUTH, ("sines",)), BENCH)
    at = np.searchsorted(run.command_time, run.time, side="right") - 1
    duty = np.round(885 * np.clip((run.command[at] - replay(TRUTH, run)) / 0.25, -1.0, 1.0))
    shown = output_of([replace(run, output=duty)])
    assert shown is not None
    assert shown.full_error == pytest.approx(0.25, rel=0.03)
    current = np.abs(run.position - 0.1)
    assert output_of([replace(run, output=current)]) is None


def test_the_command_says_what_a_log_without_a_load_cannot_tell(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (recording,) = recordings(Law(2.0, 0.0, 0.1, 0.05), ("sines",), Bench(inertia=1e-3))
    write(recording, tmp_path / "log.parquet")
    assert main(["identify-actuator", str(tmp_path / "log.parquet"), "--out", str(tmp_path / "servo")]) == 0
    printed = capsys.readouterr().out
    assert "kd / kp" in printed
    assert "the load is unknown" in printed.replace("\n", " ")
    assert [p.name for p in (tmp_path / "servo").iterdir()] == ["actuator.json"]
    known = ["identify-actuator", str(tmp_path / "log.parquet"), "--inertia", "1e-3", "--gravity", "0", "--ask"]
    assert main([*known, "--out", str(tmp_path / "servo")]) == 0
    assert "actuator.xml read back replays 1 recordings" in capsys.readouterr().out.replace("\n", " ")
    written = {p.name for p in (tmp_path / "servo-2").iterdir()}
    assert written == {"actuator.json", "actuator.py", "actuator.xml", "replay-sines.svg"}
    assert main(["identify-actuator", str(tmp_path / "log.parquet"), "--mass", "1"]) == 1
    assert "mass is given alone" in capsys.readouterr().err


def test_an_arm_that_a_log_names_is_carried_too() -> None:
    (one,) = recordings(TRUTH, ("sines",))
    named = replace(one, provenance={"mass": "0.5", "length": "0.15", "arm_mass": "0.2"})
    (run,), _, said = runs_of([named], Bench())
    assert run.bench.moment == pytest.approx((0.5 + 0.1) * 0.15 * GRAVITY)
    assert run.bench.about_axis == pytest.approx((0.5 + 0.2 / 3.0) * 0.15**2)
    assert "0.5 kg at 0.15 m, on an arm of 0.2 kg" in said[0]
    model = mujoco.MjModel.from_xml_string(mjcf_text(Law(2.0), run.bench, 2e-3))
    data = mujoco.MjData(model)
    data.qpos[0] = np.pi / 2.0
    mujoco.mj_forward(model, data)
    assert data.qfrc_bias[0] == pytest.approx(run.bench.moment, rel=1e-6)
    assert 1.0 / data.qLDiagInv[0] == pytest.approx(run.bench.about_axis, rel=1e-6)


def test_a_command_that_stops_is_said_to_be_held() -> None:
    (one,) = recordings(TRUTH, ("sines",))
    command = one.channel("command")
    first = command.time < 1.0  # as of a CSV whose cells are empty from then on
    cut = one.with_channel(command.replace(time=command.time[first], values=command.values[first]))
    assert not any("taken to hold" in note for note in runs_of([one], BENCH)[2])
    (said,) = runs_of([cut], BENCH)[2]
    assert "no command from 0.99" in said
    assert "torque_enable" in said
    on = command.replace(name="torque_enable", unit="", values=np.ones_like(command.values))
    assert runs_of([cut.with_channel(on)], BENCH)[2] == []


def test_impossible_benches_and_recordings_are_named(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="mass is -1"):
        Bench(mass=-1.0, length=0.1)
    path = tmp_path / "bench.toml"
    path.write_text("mas = 1.0\n", encoding="utf-8")
    with pytest.raises(ParameterError, match=r"unknown key 'mas'.*did you mean 'mass'"):
        Bench.read(path)
    with pytest.raises(ParameterError, match=r"length is 150 m; is that mm or cm\?"):
        Bench(mass=0.35, length=150.0)
    (one,) = recordings(TRUTH, ("sines",))
    with pytest.raises(UnknownNameError, match="elbow"):
        runs_of([one], BENCH, "elbow")
    with pytest.raises(UnknownNameError, match="dead band"):
        identify_actuator([one], bench=BENCH, ask=["dead-band"])
    without = Recording("log", {"position": one.channel("position")})
    with pytest.raises(RecordingError, match="no command"):
        runs_of([without], BENCH)


@pytest.mark.parametrize(("factor", "said"), [(-1.0, "command has the other sign"), (57.3, "position in degrees")])
def test_a_position_that_cannot_follow_its_command_so_is_refused(factor: float, said: str) -> None:
    (one,) = recordings(TRUTH, ("sines",))
    told = one.channel("command")
    followed = told.replace(name="position", values=0.95 * factor * np.roll(told.values, 3, axis=0))
    with pytest.raises(RecordingError, match=f"{said}.*Correct unit or sign in the mapping.*sines"):
        identify_actuator([one.with_channel(followed)], bench=BENCH)


def test_numbers_that_nobody_called_angles_are_refused() -> None:
    log = logged(TRUTH, "sines", np.random.default_rng(3))
    bare = [
        log.channel(name).replace(unit="", values=300.0 * log.channel(name).values) for name in ("command", "position")
    ]
    with pytest.raises(RecordingError, match=r"position of '\w+', which reaches .* no unit: say in the mapping"):
        runs_of([log.with_channel(bare[0]).with_channel(bare[1])], BENCH)


def test_what_was_left_out_when_a_log_was_read_is_said() -> None:
    (one,) = recordings(TRUTH, ("sines",))
    read = one.replace(provenance={"warnings": "sines.csv: 3 rows were left out"})
    assert "'sines': sines.csv: 3 rows were left out" in runs_of([read], BENCH)[2]


def test_the_page_shows_what_works(found: Actuator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    for recording in recordings(Law(2.0, 0.0, 0.1, 0.05), ("sines",), Bench(inertia=1e-3)):
        (tmp_path / "logs").mkdir()
        write(recording, tmp_path / "logs" / "sines.parquet")
    names: dict[str, object] = {}
    unknown = first.replace("bench=trueup.Bench(mass=0.49, length=0.1)", "bench=trueup.Bench()")
    assert unknown != first
    exec(unknown, names)
    assert (tmp_path / "servo" / "actuator.json").exists()
    found.write(tmp_path / "servo")
    monkeypatch.syspath_prepend(str(tmp_path / "servo"))
    exec(second, names)
    data: object = names["data"]
    assert abs(data.qpos[0] - 0.8) < 0.4  # type: ignore[attr-defined]
    assert trueup.identify_actuator is identify_actuator


def test_where_a_horn_that_sits_askew_lets_the_load_hang_is_found() -> None:
    askew = replace(BENCH, hangs_at=-0.07)
    law = Law(1.5, 2e-3, 0.05, 0.02)
    logs = recordings(law, ("steps", "sines", "drop"), askew)
    found = identify_actuator(logs, bench=BENCH, ask=("load askew",))
    straight = identify_actuator(logs, bench=BENCH, ask=())
    assert "load askew" in found.structures
    assert found.bench.hangs_at == pytest.approx(-0.07, abs=5e-3)
    assert found.error(held_out=False) < 0.5 * straight.error(held_out=False)
