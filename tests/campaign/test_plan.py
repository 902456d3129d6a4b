# SPDX-License-Identifier: Apache-2.0
"""A plan says what is wrong with it: file, table, key, value, and what would be right."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from trueup.campaign.plan import plan_in, read_plan, templates
from trueup.campaign.resolve import parts_of
from trueup.errors import ParameterError, PlanError

Write = Callable[..., Path]


def quiet(line: str) -> None:
    """Says nothing."""


def complaint(path: Path) -> str:
    with pytest.raises(PlanError) as found:
        parts_of(read_plan(path), path.parent / "out", quiet)
    return str(found.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("seed = 3", "sead = 3", ("unknown key 'sead' = 3", "did you mean 'seed'", "calibrate, evaluate, experiment")),
        ("seed = 3", 'seed = "three"', ("seed = 'three'", "whole number")),
        ("seed = 3", "seed = -1", ("seed = -1 must be at least 0",)),
        ("samples = 4", "samples = 4.5", ("[optimize], samples = 4.5", "whole number")),
        ("samples = 4", "samples = true", ("samples = True", "whole number")),
        ("samples = 4", "samples = 0", ("[optimize]", "samples = 0 must be at least 1")),
        ("trust = 0.3", "trust = 3", ("trust = 3", "at most 1")),
        ("samples = 4", "samples = 4\nwiden = -1", ("widen = -1", "at least 0")),
        ("candidates = 2", "candidates = 2\napart = nan", ("[transfer]", "apart = nan must be at least 0")),
        ("rounds = 2", "rounds = 2\ntrials = -5", ("trials = -5 must be at least 0",)),
        ("rounds = 2", "improvement = -3", ("[stop]", "improvement = -3", "at least 0")),
        ("rounds = 2", "rounds = 2\n[limits.joints.x]\nrange = [1, -1]", ("[limits.joints.x]", "lowest", "this order")),
        ("rounds = 2", "rounds = 2\n[limits.joints.x]\nspeed = -1", ("[limits.joints.x]", "speed = -1")),
        ("rounds = 2", 'success = "good"', ("success = 'good'", "a number")),
        ("rounds = 2", "rounds = 2\n[limits.joints.x]\nrange = [1.0]", ("[limits.joints.x], range", "2 values")),
        ("rounds = 2", "rounds = 2\n[limits.workspace]\nx = 3", ("[limits.workspace], x = 3", "list")),
        ("rounds = 2", "rounds = ", ("not valid TOML", "line")),
        ("[robot]", "[robots]", ("[robot] is missing",)),
        ('"toy:Lag"', '"lag"', ("[simulator]", "simulator 'lag'", "mujoco", "module:attribute")),
        ('"toy:Lag"', '"toi:Lag"', ("no module 'toi'",)),
        ('"toy:Lag"', '"toy:Log"', ("toy.py", "has no 'Log'")),
        ('"toy:Lag"', '"toy:STEP"', ("is a float, not a class",)),
        ('"toy:Lag"', '"toy:Lag"\nsteep = 1', ("unknown key 'steep'", "did you mean 'step'", "parameters, step")),
        ('"toy:Lag"', '"toy:Lag"\nstep = "fine"', ("step = 'fine'", "a number")),
        ('"toy:Nearby"', '{ type = "toy:Nearby", generation = "x" }', ("[optimize.search], generation = 'x'", "whole")),
        ('"toy:Cart"', '"toy:Nearby"\nstart = [0.5]', ("'toy:Nearby' is no robot: it lacks perform, repeatable",)),
        ('"toy:Nearby"', "5", ("[optimize.search] = 5", "name in quotes")),
        ('"toy:regression"', '{ type = "toy:regression", speed = 1 }', ("unknown key 'speed' = 1; keys are: none",)),
        ('"toy:Lag"', '"mujoco"\nmodle = "arm.xml"', ("'model'", "keys are: model, parameters, refuse")),
        ('"toy:Lag"', '"mujoco"', ("'mujoco' needs 'model'; it takes: model, parameters, refuse",)),
        ('"toy:Lag"', '"bicycle"\nsay = "x"', ("'say'", "keys are: max_steering, name, parameters, seed, step")),
        ("[calibrate]", '[calibrate]\nsearch = "newton"', ("search = 'newton'", "auto, gradient, cma-es, hybrid")),
        ("[calibrate]", '[calibrate]\nrecordings = ["logs/*.csv"]', ("'logs/*.csv' finds nothing",)),
        ("[calibrate]", '[calibrate]\nhold_out = ["fast"]', ("'fast' is none of the recordings",)),
    ],
)  # fmt: skip
def test_a_wrong_plan_is_explained(write_plan: Write, old: str, new: str, words: tuple[str, ...]) -> None:
    path = write_plan((old, new))
    said = complaint(path)
    assert said.startswith(str(path))
    for word in words:
        assert word in said


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("max_steering = 0.698", "max_steering = 40", ("[simulator]", "max_steering is 40", "40 degrees are 0.6981 rad")),
        ("max_speed = 1.0", "max_speed = -1", ("[task]", "max_speed is -1", "must be positive, in m/s")),
        ("edges = [0.5, 0.8]", "edges = [0.8, 0.5]", ("[task]", "edges is [0.8, 0.5]", "the lower one first")),
        ("# period = 0.02", "period = 20", ("[task]", "period is 20", "is it in ms?")),
        ('"k3", "lead"', '"k9", "lead"', ("[task]", "parameter 'k9' is not in the path follower", "k1, k2, k3, lead")),
        ("# nominal = { k1", "nominal = { k9", ("[task]", "nominal parameter 'k9' is not in what is tuned")),
        ('method = "drives"', 'parameters = ["wheel"]\nmethod = "drives"', ("[calibrate], parameters", "'wheel'")),
    ],
)  # fmt: skip
def test_numbers_and_names_that_cannot_be_are_said_before_the_robot_moves(
    tmp_path: Path, old: str, new: str, words: tuple[str, ...]
) -> None:
    path = tmp_path / "campaign.toml"
    text = (templates()["stanley"] / "campaign.toml").read_text("utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    shutil.copy(templates()["stanley"] / "path.csv", tmp_path)
    with pytest.raises(ParameterError) as error:
        parts_of(read_plan(path), tmp_path / "out", quiet)
    assert words[0].startswith("[calibrate]") or str(error.value).startswith(str(path))
    for word in words:
        assert word in str(error.value)


def test_a_parameter_that_the_simulator_lacks_is_named(write_plan: Write) -> None:
    path = write_plan(("[calibrate]", '[calibrate]\nparameters = ["gian"]'))
    with pytest.raises(ParameterError, match=r"'gian' is not in simulator 'lag' .did you mean 'gain'"):
        parts_of(read_plan(path), path.parent, quiet)


def test_only_the_named_parameters_are_calibrated(write_plan: Write) -> None:
    path = write_plan(("[calibrate]", '[calibrate]\nparameters = ["dr*"]'))
    space = parts_of(read_plan(path), path.parent, quiet).simulator.parameters
    assert [p.name for p in space.parameters if not p.frozen] == ["drag"]
    assert space.names == ("gain", "drag")


def test_paths_in_options_are_relative_to_the_plan(write_plan: Write) -> None:
    path = write_plan(('"toy:Cart"', '"toy:Cart"\nfolder = "here"'))
    robot = parts_of(read_plan(path), path.parent, quiet).robot
    assert vars(robot)["_folder"] == path.parent / "here"


def test_a_method_of_ones_own_gets_what_it_asks_for_by_name(write_plan: Write) -> None:
    path = write_plan()
    calibrator = parts_of(read_plan(path), path.parent, quiet).calibrator
    assert calibrator is not None
    with pytest.raises(ValueError, match="concatenate"):  # its own error, not one of the plan
        calibrator((), (), lambda point: None, None)


MOTION = """
[robot]
type = "by-hand"
[simulator]
type = "mujoco"
model = "small_humanoid.xml"
[task]
type = "transition"
start = "sit"
goal = "stand"
between = ["lean"]
"""


def test_a_motion_is_searched_before_the_robot_moves_and_fitted_to_whole_runs_unless_its_plan_says_otherwise() -> None:
    plan = plan_in(MOTION, Path("plan.toml"))
    assert (plan.experiment.settings, plan.transfer.incumbent) == (0, False)
    assert (plan.calibrate.method.type, plan.calibrate.choose) == ("whole-runs", True)
    other = plan_in(MOTION + '[calibrate]\nmethod = "fit"\n[experiment]\nsettings = 2\n', Path("plan.toml"))
    assert (other.calibrate.method.type, other.experiment.settings) == ("fit", 2)
    assert other.optimize.samples == plan.optimize.samples
    template = read_plan(templates()["motion"] / "campaign.toml").plan
    assert (template.experiment, template.transfer, template.stop) == (plan.experiment, plan.transfer, plan.stop)
    assert (template.calibrate.choose, template.optimize.samples) == (plan.calibrate.choose, plan.optimize.samples)


def test_a_plan_that_tunes_on_the_robot_has_trials_for_it_unless_it_says_otherwise() -> None:
    template = read_plan(templates()["walk"] / "campaign.toml").plan
    assert (template.experiment.repeats, template.transfer.candidates, template.stop.trials) == (2, 10, 60)
    assert (template.calibrate.method.type, template.transfer.incumbent) == ("none", False)
    assert template.task.options["runs"] == 1
    text = (templates()["walk"] / "campaign.toml").read_text("utf-8").replace("# candidates = 10 ", "candidates = 4 ")
    other = plan_in(text.replace('method = "on-robot"', 'method = "simulator"'), Path("plan.toml"))
    assert (other.transfer.candidates, other.stop.trials, other.transfer.incumbent) == (4, 0, True)


def test_a_motion_s_simulator_is_as_unsure_as_a_humanoid_s_model_may_be_wrong(tmp_path: Path) -> None:
    parts = parts_of(read_plan(templates()["motion"] / "campaign.toml"), tmp_path / "out", quiet)
    space = parts.simulator.parameters
    assert parts.later is None
    assert {"kp", "damping", "friction", "delay", "torso.mass", "left_knee+right_knee.zero"} < set(space.names)
    assert (space["kp"].lower, space["kp"].upper) == (pytest.approx(25 / 3), pytest.approx(75))
    assert space["left_thigh+right_thigh.com_x"].upper == pytest.approx(0.0175)  # a twentieth of the torso's height
