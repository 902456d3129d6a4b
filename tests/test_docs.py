# SPDX-License-Identifier: Apache-2.0
"""The pages say what is so: their tables are complete, their examples can be read."""

from __future__ import annotations

import re
from pathlib import Path

from trueup.simulators.mujoco.declaration_file import read_declarations
from trueup.simulators.mujoco.quantities import kinds

PAGE = Path(__file__).resolve().parents[1] / "docs" / "calibrate.md"


def test_the_table_of_quantities_is_complete() -> None:
    rows = re.findall(r"^\| `(\w+)` \| (\w+) \| ([^|]+) \| ([^|]+) \|$", PAGE.read_text("utf-8"), re.MULTILINE)
    assert rows == [(k.name, k.family, k.unit or "-", k.title) for k in kinds().values()]


def test_the_example_of_a_parameters_file_is_one(tmp_path: Path) -> None:
    (example,) = re.findall(r"```toml\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    (tmp_path / "parameters.toml").write_text(example, encoding="utf-8")
    lines = read_declarations(tmp_path / "parameters.toml")
    assert [line.quantity for line in lines] == ["kp", "friction", "friction_creep", "delay", "mass"]
    assert lines[-1].frozen
