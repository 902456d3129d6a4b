# SPDX-License-Identifier: Apache-2.0
"""Three real arms: torque that the fit never saw is predicted as well as promised, without a word of configuration."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trueup.formats import ChannelColumns, ChannelMap, TimeColumn, read
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.identify import Options, identify
from trueup.identification.estimation.matching import matched
from trueup.identification.estimation.result import relative_error
from trueup.identification.model_file import load_tree


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("model", "log", "goal", "costly"),
    # Of the UR10, cross-validation within the 19 s that are fitted prefers possible bodies; what follows does not quite.
    [("panda/panda.urdf", "panda", 0.013, 1.02), ("ur10/ur10_robot.urdf", "ur10/bag_sqlite3", 0.04, 1.04)],
)
def test_held_out_torque_is_predicted(real_data: Path, model: str, log: str, goal: float, costly: float) -> None:
    tree, (runs, _), _ = matched(load_tree(real_data / model), (read(real_data / log), []))
    found = identify(tree, runs, options=Options(cutoff=10.0, hold_out=0.3))
    assert relative_error(found.held_out()) <= goal
    assert relative_error(found.held_out(), "consistent") <= costly * relative_error(found.held_out())
    assert found.alignment is not None
    assert not found.alignment.corrected


@pytest.mark.realdata
def test_a_coupled_wrist_that_nobody_mentioned_is_found_and_the_clocks_are_set_right(real_data: Path) -> None:
    tree = load_tree(real_data / "tx40/tx40_mdh_modified.urdf")
    columns = tuple(f"Joint_{k}" for k in range(1, 7))
    files = {"position": "pos_read_data.csv", "torque": "curr_data.csv"}
    mapping = ChannelMap(
        {name: ChannelColumns(columns, file=file, labels=tree.joints) for name, file in files.items()},
        TimeColumn(rate=5e3),
    )
    (log,) = read(real_data / "tx40", mapping)
    ratios, offsets = (32.0, 32.0, 45.0, -48.0, 45.0, 32.0), (0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0)
    entries = {j: {"ratio": r, "offset": o} for j, r, o in zip(tree.joints, ratios, offsets, strict=True)}
    couplings = [{"drive": tree.joints[5], "joint": tree.joints[4]}]
    gears = Drives.from_dict(
        {"positions": "motor", "torques": "motor", "joints": entries, "couplings": couplings}, tree.joints
    )
    q, tau = log.channel("position"), log.channel("torque")
    decoupled = log.with_channel(q.replace(values=gears.joint_positions(q.values)))
    decoupled = decoupled.with_channel(tau.replace(values=gears.joint_torques(tau.values)))
    found = identify(tree, [decoupled], options=Options(cutoff=100.0, hold_out=0.35, consistent=False))
    assert relative_error(found.held_out()) <= 0.09
    assert any("joint_6 turns with joint_5" in w for w in found.warnings)
    assert found.alignment is not None
    assert found.alignment.shift == pytest.approx(-0.0022, abs=0.0005)
