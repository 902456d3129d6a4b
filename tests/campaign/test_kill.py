# SPDX-License-Identifier: Apache-2.0
"""Killed anywhere and resumed, a campaign is the one that was never killed."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

KILLING = Path(__file__).with_name("killing.py")


def outcome(folder: Path, kills: int, *more: str) -> dict[str, int]:
    done = subprocess.run(
        [sys.executable, str(KILLING), str(folder / "killed"), str(kills), "11", *more],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_fifty_kills_change_no_byte_of_the_journal_and_every_trial_is_performed_once(tmp_path: Path) -> None:
    found = outcome(tmp_path, 50)
    assert found["struck"] >= 50
    assert found["differ"] == 0
    assert found["lost"] == found["twice"] == 0


def test_a_robot_without_memory_never_performs_a_trial_twice(tmp_path: Path) -> None:
    found = outcome(tmp_path, 5, "forgetful")
    assert found["twice"] == 0
    assert found["unknown"] > 0  # what became of an interrupted run is left to the operator, and journaled


def test_a_campaign_by_hand_survives_kills_while_logs_are_taken(tmp_path: Path) -> None:
    found = outcome(tmp_path, 5, "by-hand")
    assert found["differ"] == found["lost"] == found["twice"] == 0
