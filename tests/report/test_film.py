# SPDX-License-Identifier: Apache-2.0
"""Film strips hold the pictures they were given; replays hold the poses, and a browser draws them."""

from __future__ import annotations

import base64
import json
import re
import zlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from trueup.errors import ParameterError
from trueup.film import Film
from trueup.report.film_replay import film_replay
from trueup.report.film_strip import film_strip, png


def test_a_png_holds_its_picture() -> None:
    picture = np.random.default_rng(0).integers(0, 256, size=(7, 5, 3), dtype=np.uint8)
    data = png(picture)
    assert data[16:24] == (5).to_bytes(4, "big") + (7).to_bytes(4, "big")
    body = data[data.index(b"IDAT") + 4 :]
    rows = np.frombuffer(zlib.decompress(body), dtype=np.uint8).reshape(7, 16)
    assert set(rows[:, 0].tolist()) == {2}  # each row is told as its difference to the one above
    np.testing.assert_array_equal(np.cumsum(rows[:, 1:], axis=0, dtype=np.uint8).reshape(7, 5, 3), picture)


def test_a_strip_has_a_row_for_each_run_and_its_instants_below() -> None:
    pictures = np.random.default_rng(0).integers(0, 256, size=(4, 8, 6, 3), dtype=np.uint8)
    strip = film_strip({"simulation": pictures, "robot": pictures[::-1]}, [0.0, 0.3, 0.6, 0.9], "Sit to stand")
    held = [base64.b64decode(d) for d in re.findall(r'href="data:image/png;base64,([^"]+)"', strip)]
    assert held == [png(p) for p in (*pictures, *pictures[::-1])]
    assert [t for t in re.findall(r">([^<>]+) s</text>", strip)] == ["0.00", "0.30", "0.60", "0.90"]
    with pytest.raises(ParameterError, match="'robot' of the film strip has 3 pictures for 4"):
        film_strip({"robot": pictures[:3]}, [0.0, 0.3, 0.6, 0.9], "")


def test_a_replay_holds_poses_and_shapes_and_is_small(swinging: Callable[..., Film]) -> None:
    whole = swinging()
    text = film_replay([whole, swinging("robot")])
    data = json.loads(re.findall(r'<script type="application/json">(.+?)</script>', text)[0])
    assert [f["name"] for f in data["films"]] == ["simulation", "robot"]
    column = data["films"][0]["poses"]
    codes = np.frombuffer(base64.b64decode(column["d"]), "<i2")
    poses = (column["o"] + column["s"] * codes).reshape(20, 2, 7)
    np.testing.assert_allclose(poses[..., :3], whole.position, atol=1e-4)
    np.testing.assert_allclose(poses[..., 3:], whole.orientation, atol=1e-4)
    assert len(text) < 20_000
    with pytest.raises(ParameterError, match=r"one rate; these have \[25\.0, 50\.0\] Hz"):
        film_replay([whole, swinging(rate=50.0)])
    with pytest.raises(ParameterError, match="none"):
        film_replay([replace(whole, time=whole.time[:1])])
