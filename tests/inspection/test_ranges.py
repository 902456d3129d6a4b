# SPDX-License-Identifier: Apache-2.0
"""Positions beyond a joint's range in the model are said, with the slip that is likely behind them."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path

import numpy as np
import pytest

from trueup.cli import main
from trueup.errors import RecordingError
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording

_ARM = """<mujoco>{}<worldbody><body><joint name="j" axis="0 1 0" range="-2 2" limited="true"/><geom size=".05" mass="1"/>
</body></worldbody><actuator><position joint="j"/></actuator></mujoco>"""


def swing(size: float) -> Recording:
    time = np.arange(0.0, 4.0, 0.02)
    values = size * np.sin(3.0 * time)[:, None]
    return Recording("run", {n: Channel(n, ("j",), "rad", time, values) for n in ("position", "command")})


@pytest.mark.parametrize(
    ("compiler", "size", "said"),
    [
        ("", 1.07, ["'j' is measured from -1.07 to 1.07 rad", "-0.0349 to 0.0349 rad", "-2 to 2", 'angle="radian"']),
        ("", 2.4, ["beyond its range", "the same joint"]),
        ('<compiler angle="radian"/>', 1.9, []),
        ('<compiler angle="radian"/>', 2.1, []),  # zeros and ranges of models are not exact
        ('<compiler angle="radian"/>', 2.4, ["-2 to 2 rad", "the same joint"]),
    ],
)
def test_what_lies_beyond_a_joints_range_is_said(tmp_path: Path, compiler: str, size: float, said: list[str]) -> None:
    (tmp_path / "arm.xml").write_text(_ARM.format(compiler))
    notes = [
        note for note in prepare(tmp_path / "arm.xml", [swing(size)], propose=False).notes if "beyond its range" in note
    ]
    assert len(notes) == bool(said)
    assert all(part in notes[0] for part in said)


@pytest.mark.parametrize(("size", "said"), [(0.25, ""), (150.0, 'units = ["mm"'), (3000.0, "the same joint and unit")])
def test_a_slide_far_beyond_its_range_is_asked_for_its_unit(tmp_path: Path, size: float, said: str) -> None:
    (tmp_path / "arm.xml").write_text(
        _ARM.format("").replace('name="j" axis', 'name="j" type="slide" axis').replace("2 2", ".2 .2")
    )
    ready = prepare(tmp_path / "arm.xml", [swing(size)], propose=False, refuse=["ranges"])
    notes = [n for n in ready.notes if "beyond its range" in n]
    assert len(notes) == bool(said)
    assert all(said in note for note in notes)
    with pytest.raises(RecordingError, match=re.escape(said)) if said else contextlib.nullcontext():
        prepare(tmp_path / "arm.xml", [swing(size)], propose=False)  # no replay could follow


def test_inspect_says_it_beside_a_model(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "arm.xml").write_text(_ARM.format(""))
    run = swing(1.07)
    table = np.column_stack([run.time, run.channel("command").values, run.channel("position").values])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="time,goal_position,present_position", comments="")
    monkeypatch.chdir(tmp_path)
    assert main(["inspect", "log.csv", "--model", "arm.xml"]) == 0
    assert 'angle="radian"' in capsys.readouterr().out
