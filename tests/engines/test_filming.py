# SPDX-License-Identifier: Apache-2.0
"""Films show bodies where they were, and pictures show the robot where its recording has it."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.engines.mujoco.filming import filmed, pictures, postures
from trueup.engines.mujoco.model import Model, load
from trueup.errors import RecordingError, RenderingError, UnknownNameError
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]

MODEL = """
<mujoco>
  <worldbody>
    <geom type="plane" size="2 2 0.1"/>
    <geom name="chair" type="box" size="0.1 0.1 0.1" pos="0.5 0 0.1"/>
    <body name="torso" pos="0 0 0.5">
      <freejoint/>
      <geom type="sphere" size="0.05" rgba="0.9 0.1 0.1 1"/>
      <body name="leg">
        <joint name="hip" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" rgba="0.9 0.1 0.1 1"/>
        <body name="foot" pos="0 0 -0.3">
          <joint name="ankle" axis="0 1 0"/>
          <geom type="ellipsoid" size="0.04 0.02 0.01"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Model:
    path = tmp_path_factory.mktemp("film") / "hopper.xml"
    path.write_text(MODEL)
    return load(path)


def run(place: Array, angle: Array, **more: Channel) -> Recording:
    """(T, 3) where the torso was and (T,) the hip's angle, at 10 Hz from 5 s on."""
    time = np.linspace(5.0, 4.9 + 0.1 * len(place), len(place))
    turn = np.column_stack([np.zeros(len(place)), 0.5 * angle, np.zeros(len(place))])
    return Recording("run", {
        "position": Channel("position", ("hip",), "rad", time, angle[:, None]),
        "base_position": Channel("base_position", ("x", "y", "z"), "m", time, place),
        "base_orientation": Channel("base_orientation", ("roll", "pitch", "yaw"), "rad", time, turn),
        **more,
    })  # fmt: skip


def test_bodies_are_where_geometry_says(model: Model) -> None:
    angle = np.linspace(0.0, 0.8, 6)
    place = np.column_stack([np.linspace(0.0, 1.0, 6), np.zeros(6), np.full(6, 0.5)])
    shown = filmed(model, run(place, angle), rate=20.0, lasting=0.7)
    assert len(shown.time) == 15
    assert shown.floor == 0.0
    x, pitch = (
        np.interp(shown.time, 0.1 * np.arange(6), place[:, 0]),
        np.interp(shown.time, 0.1 * np.arange(6), 1.5 * angle),
    )
    foot = shown.position[:, 3]  # 0.3 m below the torso, turned by its pitch and the hip's angle together
    np.testing.assert_allclose(foot[:, 0], x - 0.3 * np.sin(pitch), atol=1e-6)
    np.testing.assert_allclose(foot[:, 2], 0.5 - 0.3 * np.cos(pitch), atol=1e-6)
    assert np.ptp(shown.position[:, 0]) == 0.0  # the world
    assert sorted({s.body for s in shown.shapes}) == [0, 1, 2, 3]  # the chair too, the floor not
    capsule = next(s for s in shown.shapes if s.body == 2)
    np.testing.assert_allclose(sorted(capsule.points[:, 2]), [-0.3, 0.0], atol=1e-9)
    assert capsule.radius == pytest.approx(0.02)


def test_gaps_are_bridged_and_strangers_are_named(model: Model) -> None:
    place = np.tile([0.0, 0.0, 0.5], (6, 1))
    holed = place.copy()
    holed[2:4] = np.nan
    holed[4:, 2] = 0.7
    np.testing.assert_allclose(
        postures(model, run(holed, np.zeros(6)), np.array([0.2, 0.45]))[:, 2], [0.5667, 0.7], atol=1e-3
    )
    with pytest.raises(UnknownNameError, match="knee"):
        postures(model, run(place, np.zeros(6)).rename({"hip": "knee"}), np.zeros(1))
    with pytest.raises(RecordingError, match="no 'position'"):
        postures(model, run(place, np.zeros(6)).without("position"), np.zeros(1))


def test_pictures_show_the_robot_from_the_side_where_it_was(model: Model) -> None:
    place = np.column_stack([np.zeros(3), np.zeros(3), [0.5, 0.5, 0.65]])
    try:
        seen = pictures(model, run(place, np.array([0.0, 0.6, 0.0])), [0.0, 0.1, 0.2], width=120, height=150)
    except RenderingError as error:
        pytest.skip(str(error))
    assert seen.shape == (3, 150, 120, 3)
    red = (seen[..., 0] > 1.5 * seen[..., 1]) & (seen[..., 0] > 80)
    assert red.any(axis=(1, 2)).all()
    rows, columns = (np.array([np.nonzero(r)[axis].mean() for r in red]) for axis in (0, 1))
    assert rows[2] < rows[0] - 5  # higher
    assert columns[1] < columns[0] - 3  # a leg that swung back, with x to the right


def test_a_machine_without_graphics_is_told_what_to_install(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = importlib.import_module

    def missing(name: str, *more: Any) -> Any:
        if Path(name).name.startswith("mujoco."):
            raise ImportError(f"no library for {name}")
        return whole(name, *more)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(RenderingError, match=r"cannot render off screen .*no library.*Install EGL or OSMesa"):
        pictures(model, run(np.tile([0.0, 0.0, 0.5], (3, 1)), np.zeros(3)), [0.0])
