# SPDX-License-Identifier: Apache-2.0
"""Engines that diverge and engines that are not there are said, with what mends it, in Python and in the command."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from trueup.campaign.motions import transition
from trueup.cli import main
from trueup.engines.dart import load
from trueup.errors import MissingExtraError, SimulationFailedError
from trueup.formats import write
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording
from trueup.trial import Trial

CART = """<mujoco><worldbody><body name="cart"><joint name="x" type="slide" axis="1 0 0"/>
  <inertial pos="0 0 0" mass="2" diaginertia=".1 .1 .1"/></body></worldbody>
  <actuator><position name="push" joint="x" kp="{stiffness}"/></actuator></mujoco>"""


def model(folder: Path, stiffness: float) -> Path:
    (folder / "cart.xml").write_text(CART.format(stiffness=stiffness))
    return folder / "cart.xml"


def recorded() -> Recording:
    time = np.arange(51) / 50.0
    waves = 0.1 * np.sin(3.0 * time)[:, None]
    return Recording("waves", {n: Channel(n, ("x",), "m", time, waves) for n in ("command", "position")})


@pytest.mark.parametrize("engine", ["mujoco", "dart"])
def test_an_engine_that_diverges_says_when_and_what_mends_it(tmp_path: Path, engine: str) -> None:
    if engine == "dart":
        pytest.importorskip("dartpy", reason="the second engine is an extra: pip install trueup[dart]")
    ready = prepare(model(tmp_path, 1e9), [recorded()], engine=engine)  # a spring that no step of 0.5 ms can follow
    (run,) = ready.simulator.rollout([Trial.of(recorded())], ready.simulator.parameters.nominal[None])
    assert "became unstable after" in run.failures[0]
    wanted = r"'waves': the simulation became unstable after 0\.\d+ s.*step of 2 ms.*stiffness"
    for work in (ready.calibrate, ready.compare):
        with pytest.raises(SimulationFailedError, match=wanted):
            work()
    calm = prepare(model(tmp_path, 50.0), [recorded()], engine=engine).simulator
    (whole,) = calm.rollout([Trial.of(recorded())], calm.parameters.nominal[None])
    assert not whole.failures


def test_without_dartpy_the_install_that_mends_it_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name == "dartpy" else found(name, *a))
    file = model(tmp_path, 50.0)
    wanted = r"Simulation by DART needs the package 'dartpy': pip install 'trueup\[dart\]'"
    for work in (
        lambda: load(file), lambda: prepare(file, [recorded()], engine="dart"),
        lambda: transition(file, "sit", "stand", engine="dart"),
    ):  # fmt: skip
        with pytest.raises(MissingExtraError, match=wanted):
            work()
    write(recorded(), tmp_path / "waves.parquet")
    arguments = [
        "calibrate",
        str(file),
        str(tmp_path / "waves.parquet"),
        "--engine",
        "dart",
        "--out",
        str(tmp_path / "fit"),
    ]
    assert main(arguments) != 0
    said = capsys.readouterr()
    assert "pip install" in said.err + said.out
    assert "Traceback" not in said.err + said.out
    assert not (tmp_path / "fit").exists()
