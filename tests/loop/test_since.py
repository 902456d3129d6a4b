# SPDX-License-Identifier: Apache-2.0
"""What a model lacks is told in every round: what was known stays known, and what only later recordings show is found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trueup.calibration import Calibration, Lacked, pooled_rmse
from trueup.evidence import Evidence, evidence, together
from trueup.loop.calibrate import Options, calibrate
from trueup.loop.earlier import Earlier
from trueup.loop.fit import DESCENT, REFINEMENT
from trueup.loop.prepare import Preparation, prepare
from trueup.loop.since import Since, since
from trueup.recording import Channel, Recording
from trueup.trial import Trial

ARM = """
<mujoco><compiler angle="radian"/><option integrator="implicitfast"/><worldbody>
<body name="drive"><joint name="j" axis="0 1 0" damping=".3" frictionloss="{friction}" armature="{armature}"/>
  <inertial pos="0 0 -.001" mass=".02" diaginertia="1e-5 1e-5 1e-5"/>
  <body name="arm">{gear}<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" mass="1.5"/></body></body></worldbody>
<actuator><position name="j" joint="j" kp="{kp}" kv="1.5"/></actuator></mujoco>
"""
TRUTH = {"kp": 60.0, "friction": 0.15, "armature": 0.012}
FILE = {"kp": 40.0, "friction": 0.3, "armature": 0.03}
GEAR = '<joint name="gear" axis="0 1 0" stiffness="400" damping="0.3"/>'
TIME = np.arange(0.0, 3.0, 0.01)
ALONE = Options(cross_validate=False, stages=DESCENT)
FAST, SLOW = (0.3, 0.8, 1.9, 4.0), (0.1, 0.15, 0.2, 0.3)


def recorded(folder: Path, seed: int, frequencies: Sequence[float]) -> Recording:
    """A motion of an arm whose gear twists, which its file does not know."""
    rng = np.random.default_rng(seed)
    (folder / "truth.xml").write_text(ARM.format(gear=GEAR, **TRUTH))
    waves = [a * np.sin(2 * np.pi * f * TIME + p) for a, f, p in
             zip((0.4, 0.2, 0.1, 0.05), frequencies, rng.uniform(0, 6, 4), strict=True)]  # fmt: skip
    command = Channel("command", ("j",), "rad", TIME, np.sum(waves, axis=0)[:, None])
    run = Recording(f"motion {seed}", {"command": command, "position": command.replace(name="position")})
    (seen,) = prepare(folder / "truth.xml", (), propose=False).simulator.rollout([Trial.of(run)], np.zeros((1, 0)))
    measured = seen.channels["position"][0] + rng.normal(0.0, 2e-4, (len(TIME), 1))
    return run.with_channel(command.replace(name="position", values=measured))


def prepared(folder: Path, recordings: Sequence[Recording]) -> Preparation:
    """The arm as its file has it."""
    (folder / "arm.xml").write_text(ARM.format(gear="", **FILE))
    (folder / "parameters.toml").write_text("".join(f'[[parameter]]\nquantity = "{q}"\nof = "*"\n' for q in TRUTH))
    return prepare(folder / "arm.xml", recordings, parameters=folder / "parameters.toml")


def compliance(found: Calibration) -> float:
    return float(found.lacking.partition("j.gear_compliance ")[2].split()[0])


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> tuple[Calibration, Preparation]:
    """A calibration with one slow motion, and the arm ready for one with a fast motion, too."""
    folder = tmp_path_factory.mktemp("slow")
    first, later = recorded(folder, 1, SLOW), recorded(folder, 2, FAST)
    ready = prepared(folder, [first])
    return ready.calibrate(ALONE), ready.with_recordings([first, later], ())


def refined(ready: Preparation, earlier: Earlier) -> Calibration:
    """A later round without the search anew that recordings which are replayed worse than those before would ask for."""
    options, space = Options(cross_validate=False, select=False, stages=REFINEMENT), ready.simulator.parameters
    return calibrate(
        ready.simulator, ready.recordings, options=options, start=earlier.values_in(space), earlier=earlier
    )


def test_a_gear_that_only_a_later_motion_shows_is_told_in_that_round(slow: tuple[Calibration, Preparation]) -> None:
    before, ready = slow
    assert not before.lacking
    after = refined(ready, Earlier.of(before))
    assert "replayed better with play and twist of gears" in after.lacking
    assert compliance(after) == pytest.approx(1.0 / 400.0, rel=0.2)


def test_what_the_model_lacks_is_written_beside_the_parameters_ready_to_be_given_back(tmp_path: Path) -> None:
    ready = prepared(tmp_path, [recorded(tmp_path, k, FAST) for k in (1, 2)])
    found = ready.calibrate(ALONE)
    notes = ready.write(found, tmp_path / "calibrated.xml", tmp_path / "found.toml")
    beside = tmp_path / "found_lacking.toml"
    assert any(f"--parameters {beside}" in note for note in notes)
    other = prepare(tmp_path / "arm.xml", ready.recordings, parameters=beside)
    again = other.calibrate(ALONE)
    values = {e.name: e.value for e in again.estimates}
    assert values["j.gear_compliance"] == pytest.approx(1.0 / 400.0, rel=0.2)
    assert values["j.friction"] == pytest.approx(TRUTH["friction"], rel=0.1)
    assert pooled_rmse(again.training(), after=True) < 0.9 * pooled_rmse(found.training(), after=True)
    assert not again.lacking
    other.write(again, tmp_path / "calibrated.xml", tmp_path / "found.toml")
    assert not beside.exists()  # it would be that of a calibration that is gone


def test_a_gear_that_was_known_to_twist_is_told_again_where_later_motions_bear_it_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    came: list[Since | None] = []
    monkeypatch.setattr("trueup.loop.missing.since", lambda *given: came.append(since(*given)) or came[-1])
    old, new = [recorded(tmp_path, k, FAST) for k in (1, 2)], recorded(tmp_path, 3, FAST)
    ready = prepared(tmp_path, old)
    before = ready.calibrate(ALONE)
    assert "replayed better with play and twist of gears" in before.lacking
    whole = Earlier.of(before)
    assert whole.lacked is not None
    held = {name: sizes for name, sizes in whole.lacked.intervals.items() if name != "j.armature"}
    for earlier in (
        whole,
        replace(whole, lacked=replace(whole.lacked, intervals=held)),
    ):  # it was held, and is told by now
        after = ready.with_recordings([*old, new], ()).calibrate(ALONE, earlier=earlier)
        assert "replayed better with play and twist of gears" in after.lacking
        assert came[-1] is not None, (
            "an answer that later recordings bear out is asked for anew, which takes as long as a fit"
        )
        assert came[-1].known is not None
        assert compliance(after) == pytest.approx(1.0 / 400.0, rel=0.2)
        assert all(np.isfinite([e.low, e.high]).all() for e in after.estimates if e.fitted)


def test_what_was_taken_for_lacking_gives_way_to_what_a_later_motion_shows(
    slow: tuple[Calibration, Preparation],
) -> None:
    before, ready = slow
    fitted = {e.name: (e.value, e.low, e.high) for e in before.estimates}
    spring = {"j.spring": (0.5, 0.4, 0.6), "j.spring_rest": (0.0, -0.1, 0.1)}
    wrong = replace(Earlier.of(before), lacked=Lacked({**fitted, **spring}, Evidence(0.2, 0.01)))
    after = refined(ready, wrong)
    assert "play and twist of gears" in after.lacking
    assert compliance(after) == pytest.approx(1.0 / 400.0, rel=0.2)


def test_evidence_of_recordings_that_came_in_two_parts_is_about_that_of_all_of_them() -> None:
    rng = np.random.default_rng(0)
    without, with_it = np.exp(rng.normal(0.0, 0.1, 4000)), np.exp(rng.normal(-0.2, 0.1, 4000))
    whole, parts = (
        evidence(without, with_it),
        [evidence(without[k], with_it[k]) for k in (slice(1000), slice(1000, None))],
    )
    both = together(parts[0], 1, parts[1], 3)
    assert both.gain == pytest.approx(whole.gain)
    assert both.standard_error == pytest.approx(whole.standard_error, rel=0.02)
    assert not together(parts[0], 1, Evidence(-0.2, 0.001), 3).holds
