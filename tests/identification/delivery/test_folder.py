# SPDX-License-Identifier: Apache-2.0
"""What is handed over is as good as what was found: files read back, a compiled header, the model file in Pinocchio."""

from __future__ import annotations

import json
import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import trueup
from trueup.errors import ModelError
from trueup.identification.delivery.compiled import compiled
from trueup.identification.delivery.folder import deliver
from trueup.identification.delivery.source import c_header, prefix, python_file
from trueup.identification.effects import Effect
from trueup.identification.estimation.identify import Options, identify
from trueup.identification.estimation.result import Deliverable, Identification
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.model_file import load_tree
from trueup.identification.regressors import inverse_dynamics
from trueup.identification.torque_model import TorqueModel
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]
KINDS = ("rotor", "coulomb", "viscous", "quadratic", "offset", "saturating", "root", "asymmetric",
         "spring", "hysteresis", "load", "gain")  # fmt: skip

URDF = """<robot name="arm">
  <link name="base"/>
  <joint name="joint1" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.3"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="3" effort="200"/></joint>
  <link name="upper"><inertial><origin xyz="0.1 0 0"/><mass value="9"/>
    <inertia ixx="0.2" ixy="0" ixz="0" iyy="0.3" iyz="0" izz="0.3"/></inertial></link>
  <joint name="joint2" type="revolute"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.2 0 0" rpy="1.5707963 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="3" effort="150"/></joint>
  <link name="lower"><inertial><origin xyz="0.2 0 0"/><mass value="6"/>
    <inertia ixx="0.05" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.2"/></inertial></link>
  <joint name="joint3" type="revolute"><parent link="lower"/><child link="hand"/><origin xyz="0.4 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="3" effort="60"/></joint>
  <link name="hand"><inertial><origin xyz="0.05 0 0.1"/><mass value="3"/>
    <inertia ixx="0.03" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.02"/></inertial></link>
</robot>
"""


PAGE = Path(__file__).resolve().parents[3] / "docs" / "identify.md"


def rich(tree: KinematicTree, rng: np.random.Generator) -> TorqueModel:
    """Every effect at every drive, two of which turn with other joints."""
    drives = np.eye(tree.n)
    drives[-1, -2], drives[-2, 0] = 0.7, -1.0
    terms = tuple((d, Effect(kind, 0.3), float(rng.normal())) for kind in KINDS for d in range(tree.n))
    links = np.asarray(tree.inertial)
    return TorqueModel(tree, links, drives, terms, 1.1 * links, ("N m",) * tree.n)


@pytest.fixture(scope="module")
def model(arms: SimpleNamespace) -> TorqueModel:
    tree = arms.arm()
    slides = np.array([False, False, True, False])
    return rich(tree.replace(prismatic=slides, name="4 arms */ #"), np.random.default_rng(1))


@pytest.fixture(scope="module")
def motion(arms: SimpleNamespace) -> tuple[Array, Array, Array]:
    return arms.sines(np.random.default_rng(2), np.arange(2000) / 200.0, 4)


def test_a_model_read_back_from_its_file_says_the_same_to_the_last_bit(
    model: TorqueModel, motion: tuple[Array, Array, Array], tmp_path: Path
) -> None:
    (tmp_path / "torque.json").write_text(json.dumps(model.to_dict()))
    again = trueup.load(tmp_path)
    assert np.array_equal(again.torque(*motion), model.torque(*motion))
    first = [x[0] for x in motion]
    assert np.array_equal(again.torque(*first), model.torque(*first))
    assert again.torque(*first) == pytest.approx(model.torque(*motion)[0], rel=1e-12)
    (tmp_path / "torque.json").write_text(json.dumps({**model.to_dict(), "drives": [1.0]}))
    with pytest.raises(ModelError, match="damaged"):
        trueup.load(tmp_path)
    with pytest.raises(ModelError, match=r"torque\.json is missing"):
        trueup.load(tmp_path / "nowhere")


def test_the_python_file_needs_nothing_and_says_the_same(
    model: TorqueModel, motion: tuple[Array, Array, Array], tmp_path: Path
) -> None:
    path = tmp_path / "torque.py"
    path.write_text(python_file(model))
    assert {line for line in path.read_text().splitlines() if "import" in line} == {
        "from math import copysign, cos, exp, fabs, sin, sqrt, tanh"
    }
    names = runpy.run_path(str(path))
    state, first = names["State"](), [x[:200].tolist() for x in motion]
    said = [names["torque"](*instant, state) for instant in zip(*first, strict=True)]
    assert np.abs(np.array(said) - model.torque(*motion)[:200]).max() < 1e-9


def test_the_header_compiles_without_a_warning_and_says_the_same_in_two_microseconds(
    model: TorqueModel, motion: tuple[Array, Array, Array], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "torque.h"
    path.write_text(c_header(model))
    with compiled(path, prefix(model), ("-Wall", "-Wextra", "-pedantic", "-Werror")) as runs:
        if isinstance(runs, str) and runs.startswith("no C compiler"):
            pytest.skip(runs)
        assert not isinstance(runs, str), runs
        assert np.abs(runs.torque(*motion) - model.torque(*motion)).max() < 1e-9
        assert runs.seconds(*motion) < 2e-6 * 5.0  # five times slower machines, or busy ones, do not fail
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    with compiled(path, prefix(model)) as runs:
        assert isinstance(runs, str)


def log(tree: KinematicTree, arms: SimpleNamespace, seed: int) -> Recording:
    """An arm of other bodies than its file's, with friction that no file can hold: it grows with load, and offsets."""
    rng, time = np.random.default_rng(seed), np.arange(3000) / 200.0
    q, v, a = arms.sines(rng, time, 3)
    bodies = np.asarray(tree.inertial) * np.array([[1.2], [0.8], [1.4]])
    rigid = inverse_dynamics(tree, bodies, q, v, a)
    friction = (
        (3.0 + 0.1 * np.abs(rigid)) * np.tanh(v / 0.05) + 1.5 * v + 0.3 * a + 1.0 + 0.1 * rng.normal(size=q.shape)
    )
    channels = {"position": Channel("position", tree.joints, "rad", time, q),
                "torque": Channel("torque", tree.joints, "N m", time, rigid + friction)}  # fmt: skip
    return Recording(f"run{seed}", channels)


@pytest.fixture(scope="module")
def handed(
    arms: SimpleNamespace, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Identification, dict[str, Deliverable], Path]:
    """An arm identified from two logs, judged on a third, and its folder."""
    folder = tmp_path_factory.mktemp("folder")
    (folder / "given.urdf").write_text(URDF)
    tree = load_tree(folder / "given.urdf")
    found = identify(tree, [log(tree, arms, 0), log(tree, arms, 1)], [log(tree, arms, 2)], options=Options())
    parts, _ = deliver(found, folder / "given.urdf", folder / "out")
    return found, {d.name: d for d in parts}, folder / "out"


def test_the_predictor_that_is_read_back_is_the_fit(
    handed: tuple[Identification, dict[str, Deliverable], Path],
) -> None:
    found, parts, _ = handed
    assert found.model.of_load, "the friction that grows with load was found"
    for name in ("predictor", "C header"):
        if parts[name].errors:
            assert parts[name].difference < 1e-9
            assert parts[name].relative(held_out=True) == pytest.approx(parts["fit"].relative(held_out=True), rel=1e-9)
    assert parts["Python file"].difference < 1e-9


def test_torque_is_predicted_for_a_log_of_positions_whose_columns_are_in_another_order(
    handed: tuple[Identification, dict[str, Deliverable], Path], arms: SimpleNamespace
) -> None:
    found, _, folder = handed
    (unseen,) = found.held_out()
    run = log(found.model.tree, arms, 2)
    q = run.channel("position")
    other = run.without("torque").with_channel(q.select(q.labels[::-1]))
    said = trueup.load(folder).predict(other, found.cutoff).channel("torque")
    assert said.labels == q.labels
    at = np.stack([np.interp(unseen.time, said.time, x) for x in said.values.T], axis=1)
    assert np.abs(at - unseen.fitted).max() < 1e-6
    with pytest.raises(ModelError, match="joint3"):
        trueup.load(folder).predict(run.with_channel(q.select(q.labels[:2])))


def test_the_three_lines_of_code_that_the_page_shows_for_each_file_say_the_same(
    handed: tuple[Identification, dict[str, Deliverable], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, _, folder = handed
    python = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    (c,) = re.findall(r"```c\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    shutil.copytree(folder, tmp_path / "model")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path / "model"))
    monkeypatch.delitem(sys.modules, "torque", raising=False)
    p = found.predictions[0]
    state = {"q": p.position[:5], "qd": p.velocity[:5], "qdd": np.ones((5, 3))}
    exec(python[0], state)
    one: dict[str, Any] = {k: state[k][0].tolist() for k in ("q", "qd", "qdd")}
    exec(python[1], one)
    assert one["now"] == pytest.approx(state["torque"][0], abs=1e-9)
    include, *rest = c.splitlines()
    numbers = "".join(f"double {k}[3] = {{{', '.join(map(repr, one[k]))}}};" for k in ("q", "qd", "qdd"))
    show = 'printf("%.17g %.17g %.17g", torque[0], torque[1], torque[2]);'
    text = "\n".join(
        ["#include <stdio.h>", include, "int main(void) {", numbers, "double torque[3];", *rest, show, "}"]
    )
    (tmp_path / "model" / "main.c").write_text(text)
    if (compiler := shutil.which("cc")) is None:
        pytest.skip("no C compiler was found; the Python forms are equal")
    subprocess.run([compiler, "-o", "model/main", "model/main.c", "-lm"], check=True)
    said = subprocess.run([tmp_path / "model" / "main"], capture_output=True, text=True, check=True).stdout
    assert [float(x) for x in said.split()] == pytest.approx(state["torque"][0], abs=1e-9)


def test_the_page_on_identification_from_python_runs(
    arms: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "arm.urdf").write_text(URDF)
    monkeypatch.chdir(tmp_path)
    tree = load_tree("arm.urdf")
    for k in (1, 2, 3):
        run = log(tree, arms, k)
        position, torque = run.channel("position"), run.channel("torque")
        names = [f"{joint}_{kind}" for kind in ("position", "torque") for joint in tree.joints]
        table = np.column_stack([position.time, position.values, torque.values])
        np.savetxt(f"run{k}.csv", table, delimiter=",", header=",".join(["time", *names]), comments="")
    (code,) = re.findall(r"```python\n(import trueup\n\ntree = .*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    said: dict[str, Any] = {name: np.zeros((1, 3)) for name in ("q", "qd", "qdd")}
    exec(code, said)
    assert said["torque"].shape == (1, 3)


def _in_pinocchio(pin: Any, folder: Path, q: Array, v: Array, a: Array) -> Array:
    model = pin.buildModelFromUrdf(str(folder / "given.urdf"))
    pin.loadRotorParameters(model, str(folder / "given.srdf"), False)
    data = model.createData()  # rotors are part of its inverse dynamics, friction is not
    rigid = [pin.rnea(model, data, *(np.ascontiguousarray(x) for x in s)) for s in zip(q, v, a, strict=True)]
    return np.array(rigid) + np.array(model.damping) * v + np.array(model.friction) * np.sign(v)


def test_the_model_file_is_as_good_in_pinocchio_as_the_best_model_of_its_form(
    handed: tuple[Identification, dict[str, Deliverable], Path],
) -> None:
    pin = pytest.importorskip("pinocchio", reason="the reference; pip install 'trueup[bench]'")
    found, parts, folder = handed
    squares, power = 0.0, 0.0
    columns, targets, held = [], [], []
    for p in found.predictions:
        assert p.by is not None
        said = p.by(lambda q, v, a: _in_pinocchio(pin, folder, q, v, a))
        if p.held_out:
            squares, power = float(np.sum((p.measured - said) ** 2)), float(np.sum(p.measured**2))
        own = []
        for k in range(39):  # the same form with any numbers: thirty of bodies, rotors, Coulomb and viscous friction
            unit = np.zeros(39)
            unit[k] = 1.0
            own.append(p.by(lambda q, v, a, unit=unit: inverse_dynamics(found.model.tree, unit[:30], q, v, a)
                            + unit[30:33] * a + unit[33:36] * np.sign(v) + unit[36:] * v).ravel())  # fmt: skip
        columns.append(np.array(own).T)
        targets.append(p.measured.ravel())
        held.append(p.held_out)
    fitted = [i for i, h in enumerate(held) if not h]
    x = np.linalg.lstsq(
        np.vstack([columns[i] for i in fitted]), np.concatenate([targets[i] for i in fitted]), rcond=1e-10
    )[0]
    (unseen,) = [i for i, h in enumerate(held) if h]
    best = np.sqrt(np.sum((targets[unseen] - columns[unseen] @ x) ** 2) / power)
    error = np.sqrt(squares / power)
    assert error == pytest.approx(parts["model file"].relative(held_out=True), rel=1e-4)
    assert error <= 1.05 * best
    assert error < 0.5 * parts["model file as given"].relative(held_out=True)
