# SPDX-License-Identifier: Apache-2.0
"""Which of a sensor's numbers a recording's label means."""

from __future__ import annotations

import pytest

from trueup.engines.mujoco.model import Model, load
from trueup.engines.mujoco.wiring import source_of

_ROBOT = """<mujoco><worldbody><body name="arm"><joint name="swing"/><geom size=".1"/><site name="imu"/></body></worldbody>
<sensor><jointpos name="angle" joint="swing"/><framequat name="turn" objtype="site" objname="imu"/>
<gyro name="gyro" site="imu"/></sensor></mujoco>"""


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Model:
    path = tmp_path_factory.mktemp("sensors") / "robot.xml"
    path.write_text(_ROBOT)
    return load(path)


@pytest.mark.parametrize(
    ("labels", "columns"),
    [
        (("turn.w", "turn.x", "turn.y", "turn.z"), [1, 2, 3, 4]),
        (("turn[3]", "turn_0"), [4, 1]),
        (("gyro.x", "gyro.y", "gyro.z"), [5, 6, 7]),
        (("angle",), [0]),
    ],
)
def test_labels_name_numbers_in_the_order_in_which_the_engine_has_them(
    model: Model, labels: tuple[str, ...], columns: list[int]
) -> None:
    source = source_of(model, model.compiled, "sensors", labels)
    assert source is not None
    assert source.columns.tolist() == columns


@pytest.mark.parametrize("label", ["gyro.w", "gyro[3]", "gyro.xy", "turn", "turn."])
def test_a_label_that_is_none_of_a_sensors_numbers_is_no_signal(model: Model, label: str) -> None:
    assert source_of(model, model.compiled, "sensors", (label,)) is None
