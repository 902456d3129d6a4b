# SPDX-License-Identifier: Apache-2.0
"""The command line: results in one folder, resumable; for bad input a clear error, no traceback, nothing lost."""

from __future__ import annotations

import errno
import json
import os
import re
import signal
import warnings
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.campaign.output import Output
from trueup.cli import main
from trueup.errors import ModelError

Array = NDArray[np.float64]
Call = Callable[..., tuple[int, str]]

MODEL = """<mujoco model="pendulum">
  <compiler angle="radian"/>
  <option integrator="implicitfast"/>
  <worldbody>
    <body name="link">
      <joint name="hinge" axis="0 1 0" damping="{damping}" frictionloss="0.02" armature="0.01"/>
      <inertial pos="0.1 0 0" mass="0.2" diaginertia="0.001 0.001 0.001"/>
      <body name="end" pos="0.2 0 0">
        <joint name="wrist" axis="0 1 0" damping="0.02" frictionloss="0.01" armature="0.005"/>
        <inertial pos="0.05 0 0" mass="0.05" diaginertia="0.0001 0.0001 0.0001"/>
      </body>
    </body>
  </worldbody>
  {actuators}
</mujoco>
"""
ACTUATORS = """<actuator>
    <position name="hinge" joint="hinge" kp="{kp}" kv="0.1"/>
    <position name="wrist" joint="wrist" kp="4" kv="0.05"/>
  </actuator>"""
PARAMETERS = '[[parameter]]\nquantity = "kp"\nof = "hinge"\n\n[[parameter]]\nquantity = "damping"\nof = "hinge"\n'
HEADER = "time,cmd_hinge,cmd_wrist,pos_hinge,pos_wrist"


@pytest.fixture
def call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Call:
    """Runs the command in a folder with a model, two logs and a parameters file; gives code and all that was said."""
    monkeypatch.chdir(tmp_path)
    Path("arm.xml").write_text(MODEL.format(damping=0.05, actuators=ACTUATORS.format(kp=6)))
    Path("parameters.toml").write_text(PARAMETERS)
    for seed, name in enumerate(("slow", "fast")):
        write_log(Path(f"{name}.csv"), *simulated(seed, 1.5 + 2 * seed))

    def run(*words: str) -> tuple[int, str]:
        code = main(words)
        said = capsys.readouterr()
        text = said.out + said.err
        assert "Traceback" not in text
        return code, " ".join(text.split())

    return run


def simulated(seed: int, speed: float) -> tuple[Array, Array]:
    """(T,) s and (T, 4) commands and positions of an arm that is stiffer and more damped than the model says."""
    model = mujoco.MjModel.from_xml_string(MODEL.format(damping=0.12, actuators=ACTUATORS.format(kp=9)))
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    rows, time = [], np.arange(0.0, 3.0, 0.01)
    for t in time:
        data.ctrl[:] = (0.5 * np.sin(speed * t), 0.4 * np.sin(1.3 * speed * t))
        rows.append([*data.ctrl, *(data.qpos + 1e-3 * rng.standard_normal(2))])
        mujoco.mj_step(model, data, nstep=5)
    return time, np.array(rows)


def write_log(path: Path, time: Array, values: Array, header: str = HEADER) -> None:
    lines = [",".join(f"{x:.6f}" for x in (t, *row)) for t, row in zip(time, values, strict=True)]
    path.write_text("\n".join([header, *lines]) + "\n")


CALIBRATE = ("calibrate", "arm.xml", "slow.csv", "fast.csv", "--hold-out", "fast", "--parameters", "parameters.toml")


def test_what_is_relative_to_the_masses_is_said_unless_one_is_searched(call: Call) -> None:
    short = ("calibrate", "arm.xml", "slow.csv", "--search", "gradient", "--force", "--parameters", "parameters.toml")
    assert "kp, damping are in proportion to the masses in the file" in call(*short)[1]
    Path("parameters.toml").write_text(PARAMETERS + '\n[[parameter]]\nquantity = "mass"\nof = "end"\n')
    assert "in proportion to the masses" not in call(*short)[1]


def test_a_calibration_leaves_its_results_in_one_folder(call: Call) -> None:
    code, said = call(*CALIBRATE, "--out", "fit")
    assert code == 0, said
    assert {p.name for p in Path("fit").iterdir()} == {
        "arm.xml", "parameters.toml", "report.html", "replay.svg", "calibration.json"
    }  # fmt: skip
    assert "held out" in said
    assert "2 parameters to calibrate: kp, damping" in said
    written = mujoco.MjModel.from_xml_path("fit/arm.xml")
    assert written.actuator_gainprm[0, 0] == pytest.approx(9, rel=0.05)
    assert written.dof_damping[0] == pytest.approx(0.12, rel=0.2)
    numbers = json.loads(Path("fit/calibration.json").read_text())
    assert [p["name"] for p in numbers["parameters"]] == ["hinge.kp", "hinge.damping"]

    before = Path("fit/arm.xml").read_bytes()
    code, said = call(*CALIBRATE, "--out", "fit", "--json", "-q")
    assert (code, Path("fit/arm.xml").read_bytes()) == (0, before)
    assert Path("fit-2/arm.xml").is_file(), "a second run never overwrites the first"
    assert json.loads(said)["model"] == "arm"

    code, said = call("calibrate", "arm.xml", "slow.csv", "fast.csv", "--hold-out", "fast.csv", "--parameters",
                      "fit/parameters.toml", "--out", "again")  # fmt: skip
    assert code == 0, said
    found = json.loads(Path("again/calibration.json").read_text())["parameters"]
    assert [p["start"] for p in found] == [p["value"] for p in numbers["parameters"]], "it starts where the first ended"


def test_the_calibrated_file_replays_as_the_calibration_said(call: Call) -> None:
    call("calibrate", "arm.xml", "slow.csv", "fast.csv", "--parameters", "parameters.toml", "--out", "fit", "-q")
    said = {r["recording"]: r for r in json.loads(Path("fit/calibration.json").read_text())["replays"]}
    code, text = call("replay", "fit/arm.xml", "slow.csv", "fast.csv", "--against", "arm.xml", "--json", "-q")
    assert code == 0
    for replay in json.loads(text):
        assert replay["rmse"] == pytest.approx(said[replay["recording"]]["rmse_after"], rel=1e-3)
        assert replay["rmse_against"] == pytest.approx(said[replay["recording"]]["rmse_before"], rel=1e-3)
    code, text = call("replay", "fit/arm.xml", "slow.csv", "--out", "pictures")
    assert code == 0
    assert "hinge" in text
    assert (Path("pictures") / "slow.svg").is_file()
    code, text = call("replay", "arm.xml", "slow.csv", "--parameters", "fit/parameters.toml", "--json", "-q")
    assert json.loads(text)[0]["rmse"] == pytest.approx(said["slow"]["rmse_after"], rel=1e-3)


def test_a_log_of_one_joint_fits_a_model_with_one_and_ends_where_the_drive_goes_off(call: Call) -> None:
    one = ACTUATORS.format(kp=6).split("\n")
    Path("one.xml").write_text(re.sub(r'<body name="end".*?</body>', "", MODEL.format(
        damping=0.05, actuators="\n".join([*one[:-2], one[-1]])), flags=re.DOTALL))  # fmt: skip
    time, values = simulated(0, 1.5)
    on = (time < 2.0).astype(float)
    write_log(
        Path("one.csv"), time, np.column_stack([values[:, [0, 2]], on]), "time,goal_position,position,torque_enable"
    )
    code, text = call("replay", "one.xml", "one.csv")
    assert code == 0, text
    assert "the only joint of the model" in text
    assert "cut to 0.00 ... 1.99 s of 2.99 s" in text


def test_an_interrupted_calibration_goes_on_where_it_was(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    save = Output.save
    seen = []

    def interrupted(self: Output, state: dict[str, object]) -> None:
        save(self, state)
        seen.append(state)
        if len(seen) == 1:
            os.kill(os.getpid(), signal.SIGTERM)  # which ends it as Ctrl-C does

    monkeypatch.setattr(Output, "save", interrupted)
    code, said = call(*CALIBRATE, "--out", "fit")
    assert code == 130
    assert "The same command goes on from there" in said
    assert not said.endswith("stopped")
    assert [p.name for p in Path("fit").iterdir()] == ["state.json"]

    monkeypatch.setattr(Output, "save", save)
    code, said = call(*CALIBRATE, "--out", "fit")
    assert code == 0, said
    assert "going on from fit/state.json" in said
    assert not Path("fit/state.json").exists()
    call(*CALIBRATE, "--out", "whole")
    whole, resumed = (json.loads(Path(f"{d}/calibration.json").read_text())["parameters"] for d in ("whole", "fit"))
    for one, other in zip(whole, resumed, strict=True):
        assert other["value"] == pytest.approx(one["value"], abs=0.2 * (one["high"] - one["low"]))


def test_a_command_that_is_stopped_says_so(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    from trueup.studies.stanley import run as study

    monkeypatch.setattr(study, "_compiled", lambda robot: os.kill(os.getpid(), signal.SIGTERM))
    code, said = call("demo", "--out", "study")
    assert code == 130
    assert said.endswith("stopped")


def test_a_state_of_another_problem_is_not_taken_up(call: Call) -> None:
    Path("fit").mkdir()
    Path("fit/state.json").write_text('{"fingerprint": "another", "search": {}}')
    code, said = call(*CALIBRATE, "--out", "fit")
    assert code == 0, said
    assert Path("fit/state.json").is_file()
    assert Path("fit-2/report.html").is_file()


def test_the_model_that_was_given_is_never_overwritten(call: Call) -> None:
    before = Path("arm.xml").read_bytes()
    code, said = call(*CALIBRATE, "--out", ".", "--force")
    assert code == 1
    assert "is the model that was given" in said
    assert Path("arm.xml").read_bytes() == before


# ---- bad input: what is done to the folder, and what must be said ----


def truncated() -> None:
    text = Path("slow.csv").read_text()
    Path("slow.csv").write_text(text[: text.rindex(",", 0, len(text) // 2) + 3].rsplit(",", 2)[0])


def column(path: str, change: Callable[[Array], None]) -> None:
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    change(rows)
    write_log(Path(path), rows[:, 0], rows[:, 1:])


def swap(rows: Array, a: int, b: int) -> None:
    rows[:, [a, b]] = rows[:, [b, a]]


def no_numbers(rows: Array) -> None:
    rows[50:, 3] = np.nan


def unsorted_time(rows: Array) -> None:
    swap(rows.T, 20, 40)


def repeated_time(rows: Array) -> None:
    rows[21, 0] = rows[20, 0]


def gap(rows: Array) -> None:
    rows[100:, 0] += 1.0


def renamed(old: str, new: str, path: str = "slow.csv") -> None:
    Path(path).write_text(Path(path).read_text().replace(old, new))


def without_actuators() -> None:
    Path("arm.xml").write_text(
        MODEL.format(damping=0.1, actuators="<actuator><motor name='m' joint='wrist'/></actuator>")
    )


def scaled(path: str) -> None:
    column(path, lambda rows: rows.__setitem__((slice(None), slice(1, None)), rows[:, 1:] * 180 / np.pi))


BAD = {
    "unsorted": (lambda: column("slow.csv", unsorted_time), r"slow\.csv, line \d+: .*time"),
    "repeated time": (lambda: column("slow.csv", repeated_time), r"slow\.csv, line 23: time 0\.2 s again.*repair"),
    "joint missing in the model": (lambda: renamed("hinge", "hinje"), r"joint 'hinje' is not in .*you mean 'hinge'"),
    "does not compile": (lambda: renamed('joint="hinge"', 'joint="henge"', "arm.xml"), r"arm\.xml.* does not compile"),
    "broken XML": (lambda: Path("arm.xml").write_text("<mujoco><body>"), r"arm\.xml"),
    "no such actuator": (without_actuators, r"actuator 'hinge' is not in .*wrist"),
    "unknown quantity": (
        lambda: renamed("damping", "dampin", "parameters.toml"), r"quantity 'dampin' is not in.*mean 'damping'.*kp"
    ),
    "unknown key": (lambda: renamed("of =", "off =", "parameters.toml"), r"unknown key 'off'.*keys are: frozen"),
    "unknown element": (lambda: renamed('"hinge"', '"hing"', "parameters.toml"), r"'hing' is not in.*mean 'hinge'"),
    "unreadable bag": (lambda: Path("slow.csv").rename("slow.mcap"), r"slow\.mcap"),
    "no such file": (lambda: Path("slow.csv").unlink(), r"slow\.csv: no such file"),
}  # fmt: skip


@pytest.mark.parametrize("what", BAD)
def test_bad_input_is_named_and_nothing_is_written(call: Call, what: str) -> None:
    break_it, expected = BAD[what]
    break_it()
    log = "slow.mcap" if Path("slow.mcap").exists() else "slow.csv"
    code, said = call("calibrate", "arm.xml", log, "--parameters", "parameters.toml", "--out", "fit")
    assert code == 1, said
    assert said.startswith("error") or " error " in said
    assert re.search(expected, said), said
    assert not Path("fit").exists()


@pytest.mark.parametrize("more", [("--dry-run",), ()])
@pytest.mark.parametrize(
    ("words", "expected"),
    [(("--hold-out", "slow"), "all were held out"), (("--channels", "torqe"), "channel 'torqe' is not in .*position")],
)
def test_what_cannot_be_fitted_is_refused_by_a_dry_run_too(
    call: Call, words: tuple[str, ...], expected: str, more: tuple[str, ...]
) -> None:
    code, said = call("calibrate", "arm.xml", "slow.csv", "--out", "fit", *words, *more)
    assert code == 1
    assert re.search(expected, said), said
    assert not Path("fit").exists()


def test_a_calibration_that_fails_leaves_no_empty_folder(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise ModelError("it fails")

    monkeypatch.setattr("trueup.loop.prepare.Preparation.calibrate", fails)
    assert call("calibrate", "arm.xml", "slow.csv", "--out", "fit")[0] == 1
    assert not Path("fit").exists()


def test_a_log_of_another_robot_is_told_from_those_that_fit(call: Call) -> None:
    other = Path("fast.csv").read_text().replace("hinge", "hip").replace("wrist", "wheel")
    Path("fast.csv").write_text(other)
    code, said = call("calibrate", "arm.xml", "slow.csv", "fast.csv", "--dry-run")
    assert code == 1
    assert "'fast' has none of the model's joints (hinge, wrist)" in said
    assert "hip, wheel" in said


ODD = {
    "truncated": (truncated, r"slow\.csv: the last line \(\d+\) is cut off and was dropped"),
    "missing numbers": (lambda: column("slow.csv", no_numbers), r"missing"),
    "a gap": (lambda: column("slow.csv", gap), r"gap lasts 1\.0"),
    "degrees": (lambda: scaled("slow.csv"), r"degrees"),
}  # fmt: skip


@pytest.mark.parametrize("what", ODD)
def test_what_is_odd_in_a_log_is_said_on_inspection(call: Call, what: str) -> None:
    break_it, expected = ODD[what]
    break_it()
    code, said = call("inspect", "slow.csv")
    assert code == 0, said
    assert re.search(expected, said), said


def test_joints_in_the_wrong_order_are_suspected(call: Call) -> None:
    def swapped(rows: Array) -> None:
        rng = np.random.default_rng(3)
        rows[:, 2] = 0.4 * np.interp(rows[:, 0], np.arange(0, 3.1, 0.3), rng.uniform(-1, 1, 11))
        rows[:, 4] = rows[:, 2]
        swap(rows, 3, 4)

    column("slow.csv", swapped)
    code, said = call("calibrate", "arm.xml", "slow.csv", "--parameters", "parameters.toml", "--out", "fit")
    assert code == 0, said
    assert "wrong order" in said


def test_a_full_disk_costs_nothing_that_was_there(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    assert call(*CALIBRATE, "--out", "fit")[0] == 0
    before = {p.name: p.read_bytes() for p in Path("fit").iterdir()}

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    code, said = call(*CALIBRATE, "--out", "fit", "--force")
    assert code == 1
    assert "No space left" in said
    assert {p.name: p.read_bytes() for p in Path("fit").iterdir()} == before


def test_a_model_that_cannot_be_written_does_not_cost_the_rest(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise ModelError("inertia must satisfy A + B >= C")

    monkeypatch.setattr("trueup.engines.mujoco.family.write_model", refused)
    code, said = call(*CALIBRATE, "--out", "fit")
    assert code == 0
    assert "could not be written: inertia must satisfy" in said
    assert "to simulate it" not in said, "there is no file to do so with"
    assert {"parameters.toml", "report.html", "calibration.json"} <= {p.name for p in Path("fit").iterdir()}


# ---- inspect ----


def test_inspect_writes_a_mapping_once(call: Call) -> None:
    code, said = call("inspect", "slow.csv", "fast.csv")
    assert code == 0, said
    assert "wrote mapping.toml" in said
    Path("mapping.toml").write_text("# mine\n" + Path("mapping.toml").read_text())
    assert call("inspect", "slow.csv")[0] == 0
    assert Path("mapping.toml").read_text().startswith("# mine")
    assert call("inspect", "slow.csv", "--force")[0] == 0
    assert not Path("mapping.toml").read_text().startswith("# mine")


def test_inspect_proposes_the_models_joints_by_order_and_calibrate_uses_them(call: Call) -> None:
    for name in ("slow.csv", "fast.csv"):
        renamed("_hinge", "_A", name)
        renamed("_wrist", "_B", name)
    code, said = call("inspect", "slow.csv", "fast.csv", "--model", "arm.xml")
    assert code == 0, said
    assert "by order" in said
    assert "A -> hinge, B -> wrist" in said
    code, said = call(*CALIBRATE, "--out", "fit")
    assert code == 0, said


def test_no_two_columns_are_proposed_as_the_same_joint(call: Call) -> None:
    """Of a joint without a position the name was given to what was measured of another one, so that no reader took it."""
    renamed("cmd_wrist", "cmd_third")
    renamed("pos_hinge", "pos_third")
    code, said = call("inspect", "slow.csv", "--model", "arm.xml")
    assert code == 0, said
    code, said = call("inspect", "slow.csv", "--model", "arm.xml")
    assert code == 0, said


def test_what_slides_is_in_metres_where_inspect_knows_the_model(call: Call) -> None:
    Path("arm.xml").write_text(
        Path("arm.xml").read_text().replace('joint name="wrist"', 'joint name="wrist" type="slide"')
    )
    code, said = call("inspect", "slow.csv", "--model", "arm.xml")
    assert code == 0, said
    assert re.search(r"position +1 x rad and 1 x m,", said)
    assert "2 x rad" in call("inspect", "slow.csv")[1]


def test_a_quaternion_is_not_asked_for_its_unit(call: Call) -> None:
    head, *rows = Path("slow.csv").read_text().splitlines()
    bodies = [f"{row},0,0,0.3,1,0,0,0" for row in rows]
    named = ",".join(f"base_{n}" for n in ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"))
    Path("slow.csv").write_text("\n".join([f"{head},{named}", *bodies]) + "\n")
    said = call("inspect", "slow.csv")[1]
    assert "4 x of a quaternion" in said
    assert "unit unknown" not in said


def test_inspect_speaks_json(call: Call) -> None:
    code, said = call("inspect", "slow.csv", "--json")
    assert code == 0
    assert json.loads(said)["recordings"][0]["name"] == "slow"


# ---- a model without actuators ----


def test_position_servos_are_added_where_a_model_has_none(call: Call) -> None:
    Path("arm.xml").write_text(MODEL.format(damping=0.1, actuators=""))
    code, said = call(*CALIBRATE, "--out", "fit")
    assert code == 0, said
    assert "position servos (stiffness and damping to start from" in said
    assert mujoco.MjModel.from_xml_path("fit/arm.xml").nu == 0, "the file stays what it was"
    written = mujoco.MjModel.from_xml_path("fit/arm_driven.xml")
    assert written.nu == 2
    assert written.actuator_gainprm[0, 0] == pytest.approx(9, rel=0.3)


@pytest.mark.parametrize(
    ("words", "code"), [(("--version",), 0), ((), 2), (("calibrate", "x.xml"), 2), (("--help",), 0)]
)
def test_usage(call: Call, words: tuple[str, ...], code: int) -> None:
    assert call(*words)[0] == code


def test_recordings_that_stand_apart_are_named(call: Call) -> None:
    code, said = call("calibrate", "arm.xml", "slow.csv", "--out", "new", "fast.csv")
    assert code == 2
    assert "'fast.csv' stands behind an option, apart: put all RECORDING arguments side by side" in " ".join(
        said.split()
    )
    assert "'new'" not in call("calibrate", "arm.xml", "slow.csv", "--outt", "new")[1]


@pytest.mark.parametrize(
    "command",
    [
        ("run", "--dry-run"),
        ("calibrate", "arm.xml", "slow.csv"),
        ("excite", "arm.xml", "--out", "new"),
        ("identify", "arm.xml", "slow.csv", "--out", "new"),
        ("ground", "slow.csv", "--out", "new"),
    ],
    ids=lambda words: words[0],
)
@pytest.mark.parametrize("seed", ["-1", "1.5", "x"])
def test_a_seed_that_no_generator_takes_is_wrong_usage(call: Call, command: tuple[str, ...], seed: str) -> None:
    code, said = call(*command, "--seed", seed)
    assert code == 2
    assert f"a seed is a whole number, 0 or above, not '{seed}'" in " ".join(said.split())


def test_what_the_engine_warns_of_is_one_note(call: Call) -> None:
    text = Path("arm.xml").read_text()
    Path("arm.xml").write_text(text.replace("<compiler ", '<compiler settotalmass="0.25" '))
    code, said = call("replay", "arm.xml", "slow.csv")
    assert code == 0, said
    assert said.count("'settotalmass' is deprecated") == 1
    assert "UserWarning" not in said
    assert "settotalmass" not in call("replay", "arm.xml", "slow.csv", "-q")[1]


def test_what_numpy_says_of_its_arithmetic_is_no_note(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(*_given: object) -> int:
        warnings.warn("Mean of empty slice", RuntimeWarning, stacklevel=1)
        warnings.warn("an old attribute", UserWarning, stacklevel=1)
        return 0

    monkeypatch.setattr("trueup.commands.doctor.run", run)
    code, said = call("doctor")
    assert code == 0
    assert "an old attribute" in said
    assert "empty slice" not in said


def test_the_end_of_each_recording_may_be_held_out(call: Call) -> None:
    given = ("calibrate", "arm.xml", "slow.csv", "--out", "fit", "--hold-out")
    code, said = call(*given, "30%", "--parameters", "parameters.toml")
    assert code == 0, said
    assert "position, held out" in said
    assert {r["recording"] for r in json.loads(Path("fit/calibration.json").read_text())["replays"]} == {
        "slow",
        "slow_end",
    }
    code, said = call(*given, "100%")
    assert code == 1
    assert "of the 300 samples of recording 'slow' both parts need two or more" in said
