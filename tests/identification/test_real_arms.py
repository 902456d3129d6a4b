# SPDX-License-Identifier: Apache-2.0
"""Three real arms: torque that the fit never saw is predicted as well as promised, without a word of configuration."""

from __future__ import annotations

from pathlib import Path

import pytest

from trueup.formats import read
from trueup.identification.identify import Options, identify
from trueup.identification.joint_names import matched
from trueup.identification.kinematic_tree import load_tree
from trueup.identification.result import relative_error


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("model", "log", "goal"), [("panda/panda.urdf", "panda", 0.013), ("ur10/ur10_robot.urdf", "ur10/bag_sqlite3", 0.07)]
)
def test_held_out_torque_is_predicted(real_data: Path, model: str, log: str, goal: float) -> None:
    tree, (runs, _), _ = matched(load_tree(real_data / model), (read(real_data / log), []))
    found = identify(tree, runs, options=Options(cutoff=10.0, hold_out=0.3))
    assert relative_error(found.held_out()) <= goal
    assert relative_error(found.held_out(), "consistent") <= 1.02 * relative_error(found.held_out())
    assert found.alignment is not None
    assert not found.alignment.corrected
