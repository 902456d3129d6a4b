# SPDX-License-Identifier: Apache-2.0
"""Paths: geometry that is exact, speeds that respect their limits, files that are read or refused."""

from __future__ import annotations

from pathlib import Path as FilePath

import numpy as np
import pytest

from trueup.errors import FormatError, RecordingError, UnknownNameError
from trueup.paths import Path, SpeedLimits
from trueup.paths.courses import COURSES, hairpin
from trueup.paths.csv import read_path
from trueup.trial import Reference


def test_a_circle_has_its_length_and_curvature() -> None:
    angle = np.linspace(0.0, 1.5 * np.pi, 400)
    path = Path.from_points("arc", np.stack([2.0 * np.cos(angle), 2.0 * np.sin(angle)], axis=1))
    assert path.length == pytest.approx(3.0 * np.pi, rel=1e-5)
    np.testing.assert_allclose(path.curvature[2:-2], 0.5, atol=2e-3)
    np.testing.assert_allclose(np.diff(path.heading[[0, -1]]), 1.5 * np.pi, atol=0.02)


def test_a_spline_passes_through_its_waypoints() -> None:
    waypoints = np.array([[0.0, 0.0], [2.0, 1.0], [3.0, -1.0], [5.0, 0.0]])
    path = Path.from_spline("waypoints", waypoints, spacing=0.01)
    for point in waypoints:
        assert np.hypot(*(path.points - point).T).min() < 0.01


def test_the_hairpin_fills_14_m_by_2_m_and_comes_back_to_its_start() -> None:
    path = hairpin()
    np.testing.assert_allclose(np.ptp(path.points, axis=0), [14.0, 2.0], atol=5e-3)
    np.testing.assert_allclose(path.points[0], path.points[-1], atol=1e-9)
    assert path.length == pytest.approx(3 * (24.0 + 2.0 * np.pi), rel=1e-3)
    assert path.heading[-1] == pytest.approx(6.0 * np.pi)
    assert 140.0 < path.duration < 165.0
    assert [np.any((path.speed >= a) & (path.speed < b)) for a, b in ((0, 0.5), (0.5, 0.8), (0.8, 1.0))] == [True] * 3


@pytest.mark.parametrize("name", sorted(COURSES))
def test_every_course_can_be_driven(name: str) -> None:
    path = COURSES[name]()
    assert np.abs(path.curvature).max() < np.sin(0.698) / 0.55, "the front axle cannot follow"
    assert np.abs(np.diff(path.heading)).max() < 0.1
    along = np.diff(path.points, axis=0)
    middle = 0.5 * (path.heading[1:] + path.heading[:-1])
    assert np.abs(along[:, 0] * np.sin(middle) - along[:, 1] * np.cos(middle)).max() < 2e-3, "heading is the direction"


def test_the_speed_profile_keeps_all_limits_and_is_nowhere_slower_than_needed() -> None:
    limits = SpeedLimits(lateral=0.3, acceleration=0.2, deceleration=0.4, start=0.1, stop=0.1)
    path = hairpin((1.0,), limits=limits)
    gain = np.diff(path.speed**2) / (2.0 * np.diff(path.arc))
    assert gain.max() <= 0.2 + 1e-9
    assert gain.min() >= -0.4 - 1e-9
    bent = np.abs(path.curvature) > 0.0
    assert (path.speed[bent] ** 2 * np.abs(path.curvature[bent])).max() <= 0.3 + 1e-9
    held = np.r_[False, np.abs(gain - 0.2) < 1e-6] | np.r_[np.abs(gain + 0.4) < 1e-6, False]
    assert (held | (path.speed > 0.999) | bent | (path.speed < 0.11)).all()


def test_a_path_survives_its_trial() -> None:
    path = COURSES["chicane"]()
    again = Path.of(path.reference(), path.name)
    for field in ("points", "heading", "curvature", "speed", "arc"):
        np.testing.assert_array_equal(getattr(path, field), getattr(again, field))


def test_files_of_many_spellings_are_read(tmp_path: FilePath) -> None:
    (tmp_path / "a.csv").write_text("# surveyed\nX;Y;v\n0;0;0.3\n1;0;0.3\n1;2;0.6\n")
    (tmp_path / "b.csv").write_text("0, 0\n1, 0\n1, 2\n")
    for name, speed in (("a", 0.3), ("b", 0.5)):
        path = read_path(tmp_path / f"{name}.csv")
        assert path.length == pytest.approx(3.0)
        assert path.speed[0] == speed


@pytest.mark.parametrize(
    "text",
    [
        "# s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps\n0; 0; 0; 0; 0; 0.3\n1; 1; 0; 0; 0; 0.3\n3; 1; 2; 1.57; 0; 0.6\n",
        "X [m];Y [m];Speed [km/h]\n0;0;1.08\n1;0;1.08\n1;2;2.16\n",
        "index,y_mm,x_mm,target_speed\n0,0,0,0.3\n1,0,1000,0.3\n2,2000,1000,0.6\n",
        "easting,northing,v\n691607,5334760,0.3\n691608,5334760,0.3\n691608,5334762,0.6\n",
        "x y speed_mps\n0 0 0.3\n1 0 0.3\n1 2 0.6\n",
    ],
)
def test_columns_of_a_path_are_named_as_those_of_logs(text: str, tmp_path: FilePath) -> None:
    """A racing line's header is a comment; of these the speed was left out, or the way taken for x, without a word."""
    (tmp_path / "line.csv").write_text(text)
    path = read_path(tmp_path / "line.csv")
    assert path.length == pytest.approx(3.0)
    assert path.speed[[0, -1]] == pytest.approx([0.3, 0.6])
    assert path.heading[[0, -1]] == pytest.approx([0.0, 0.5 * np.pi])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0,0,0.3\n1,0,0.3\n", "line 1: 3 columns without names; say .* x,y,speed"),
        ("lat,lon\n48.1,11.5\n48.1,11.6\n", "line 1: latitude and longitude; a path is in m"),
        ("x,y,speed_limit\n0,0,1\n1,0,1\n", "line 1: is 'speed_limit' the speed to drive at"),
        ("x,z\n0,0\n", "line 1: no column 'y'"),
        ("x,y\n0,0\n1,one\n", "line 3, column 2: 'one' is not a number"),
        ("x,y\n0,0\n1\n", "line 3, column 2: 'nothing'"),
        ("x,y\n0,0\n1,nan\n", "nan is not a finite number"),
        ("", "is empty"),
    ],
)
def test_a_bad_file_is_refused_with_its_place(tmp_path: FilePath, text: str, said: str) -> None:
    file = tmp_path / "bad.csv"
    file.write_text(text)
    with pytest.raises(FormatError, match=said):
        read_path(file)


def test_what_is_no_path_is_refused() -> None:
    with pytest.raises(RecordingError, match="two different finite points"):
        Path.from_points("still", np.zeros((5, 2)))
    with pytest.raises(RecordingError, match="target speed at point"):
        Path.from_points("back", [[0, 0], [1, 0]], speed=-0.1)
    with pytest.raises(RecordingError, match="three finite waypoints"):
        Path.from_spline("short", [[0, 0], [1, 0]])
    with pytest.raises(RecordingError, match="'lateral' is -1"):
        SpeedLimits(lateral=-1.0)
    with pytest.raises(UnknownNameError, match="'y'"):
        Path.of(Reference(("x", "z"), ("m", "m"), np.zeros((3, 2))))
