# SPDX-License-Identifier: Apache-2.0
"""A campaign on the toy, in a folder of its own."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

PLAN = """
name = "toy"
seed = 3
[robot]
type = "toy:Cart"
[simulator]
type = "toy:Lag"
[task]
type = "toy:Follow"
targets = ["steps", "ramps"]
[calibrate]
method = "toy:regression"
[experiment]
settings = 2
[optimize]
search = "toy:Nearby"
samples = 4
trust = 0.3
[transfer]
candidates = 2
[stop]
rounds = 2
"""


@pytest.fixture
def write_plan(tmp_path: Path) -> Callable[..., Path]:
    """Writes the toy's plan with pieces of text replaced; the toy lies beside it."""

    def write(*replaced: tuple[str, str]) -> Path:
        text = PLAN
        for old, new in replaced:
            assert old in text
            text = text.replace(old, new)
        shutil.copy(Path(__file__).with_name("toy.py"), tmp_path)
        (tmp_path / "campaign.toml").write_text(text, encoding="utf-8")
        return tmp_path / "campaign.toml"

    return write
