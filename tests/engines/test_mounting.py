# SPDX-License-Identifier: Apache-2.0
"""A gyro that turns otherwise than the base's orientation says is named, with what may be wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trueup.arrays import Array
from trueup.articulated.pose import quaternion_of, turning
from trueup.engines.mujoco.model import Model, load
from trueup.engines.mujoco.setup.mounting import mounted_otherwise
from trueup.recording import Channel, Recording

_BODY = """<mujoco><worldbody><body name="trunk"><freejoint/><geom size=".1"/><site name="imu" {how}/><body>
<joint name="knee"/><geom size=".05"/></body></body></worldbody><sensor><gyro name="gyro" site="imu"/></sensor></mujoco>"""
_TIME = np.arange(0.0, 6.0, 0.01)
_PHASES, _SIZES = np.array([2.0, 3.1, 0.9]), np.array([0.1, 0.07, 0.2])


def _model(folder: Path, how: str = "") -> Model:
    (folder / "trunk.xml").write_text(_BODY.format(how=how))
    return load(folder / "trunk.xml")


def _log(onto: Array, order: tuple[int, ...] = (0, 1, 2, 3), signs: float = 1.0) -> Recording:
    turns = _SIZES * np.sin(np.outer(_TIME, _PHASES))
    rates = turning(turns, _SIZES * _PHASES * np.cos(np.outer(_TIME, _PHASES)))
    noise = np.random.default_rng(0).normal(0.0, 0.01, (len(_TIME), 3))
    quaternion = quaternion_of(turns) * [1.0, signs, signs, signs]
    channels = (
        Channel("gyro", ("x", "y", "z"), "rad/s", _TIME, rates @ onto.T + noise),
        Channel("base_orientation", ("w", "x", "y", "z"), "", _TIME, quaternion[:, list(order)]),
    )
    return Recording("log", {c.name: c for c in channels})


_AS_IT_IS = np.eye(3)
_QUARTER = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # its x points along the base's y


def test_a_gyro_that_is_mounted_as_the_model_has_it_is_not_named(tmp_path: Path) -> None:
    assert mounted_otherwise(_model(tmp_path), [_log(_AS_IT_IS)]) == []
    assert mounted_otherwise(_model(tmp_path, 'euler="0 0 90"'), [_log(_QUARTER)]) == []


def test_a_gyro_that_is_turned_is_named_with_the_site_it_would_have(tmp_path: Path) -> None:
    (said,) = mounted_otherwise(_model(tmp_path), [_log(_QUARTER)])
    assert "mounted 90 degrees from where the model has sensor 'gyro'" in said
    assert 'quat="0.71 ' in said
    assert said.endswith("(log)")


@pytest.mark.parametrize(
    ("log", "meant"),
    [
        (_log(_AS_IT_IS, (1, 2, 3, 0)), "is x, y, z, w"),
        (_log(_AS_IT_IS, signs=-1.0), "is the inverse"),
        (_log(180.0 / np.pi * _AS_IT_IS), "is it in deg/s?"),
    ],
)
def test_quaternions_in_another_order_and_rates_in_degrees_are_named(
    tmp_path: Path, log: Recording, meant: str
) -> None:
    (said,) = mounted_otherwise(_model(tmp_path), [log])
    assert meant in said
