# SPDX-License-Identifier: Apache-2.0
"""What commands read is read in one way, whatever role a recording has."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import pytest

from trueup.commands.sources import given
from trueup.formats import TimeColumn


def test_a_rate_counts_for_logs_that_are_held_out_too(tmp_path: Path) -> None:
    logs = [tmp_path / name for name in ("run.csv", "test.csv")]
    for log in logs:
        log.write_text("pos_a,torque_a\n" + "".join(f"{0.1 * k:.1f},{k % 3}\n" for k in range(20)), encoding="utf-8")
    asked = argparse.Namespace(recordings=[str(logs[0])], hold_out=[str(logs[1])], mapping=None, model=None)
    fitted, held, _ = given(asked, rated=lambda mapping: replace(mapping, time=TimeColumn(rate=50.0)), driven=False)
    assert [r.channel("position").time[-1] for r in (*fitted, *held)] == [pytest.approx(19 / 50)] * 2
