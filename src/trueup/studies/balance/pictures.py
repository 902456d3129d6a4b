# SPDX-License-Identifier: Apache-2.0
"""Pictures of the humanoid from its left side: film strips, a replay that one can scrub, the torso's orientation in time."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from trueup.articulated.pose import quaternion_of
from trueup.recording import Recording
from trueup.report.markup import Markup, join, tag
from trueup.report.plots import AFTER, BEFORE, INK, Plot, span
from trueup.studies.balance.scenes import model_of

Array = NDArray[np.float64]

RATE = 25.0  # Hz
_FRAMES = 8
_SCALE, _SIDE, _BELOW = 300.0, 0.24, 0.03  # pixels a metre; m to each side and below the floor that are seen


def poses_of(recording: Recording, joints: Sequence[str]) -> list[list[float]]:
    """Frames at `RATE`: x, y, z, roll, pitch, yaw and the joints in their order, rounded; from the motion's start."""
    time = np.arange(0.0, recording.channel("base_position").time[-1] + 1e-9, 1.0 / RATE)
    angles = recording.channel("base_orientation")
    whole = angles.replace(values=np.unwrap(np.nan_to_num(angles.values), axis=0))
    parts = [
        recording.channel("base_position").at(time),
        whole.at(time),
        recording.channel("position").select(joints).at(time),
    ]
    frames = np.concatenate(parts, axis=1)
    return np.round(frames[np.isfinite(frames).all(axis=1)], 4).tolist()


def strip(scene: str, poses: Mapping[str, Sequence[Sequence[float]]], words: Mapping[str, str]) -> Markup:
    """Rows of pictures at the same instants, one a run: the paper's figures 3, 4, 6 and 7."""
    drawn, last = Drawn(scene), min(len(each) for each in poses.values()) - 1
    shown = np.unique(np.linspace(0, last, _FRAMES).astype(int)).tolist()
    rows = []
    for word, each in poses.items():
        pictures = [_svg(drawn.shapes(each[k]), f"{k / RATE:.2f} s") for k in shown]
        rows.append(tag("div", tag("p", words[word], class_="key"), tag("div", *pictures, class_="strip")))
    return join(*rows)


def replay(scene: str, poses: Mapping[str, Sequence[Sequence[float]]], words: Mapping[str, str], key: str) -> Markup:
    """The runs side by side, moved by a slider."""
    drawn, last = Drawn(scene), max(len(each) for each in poses.values()) - 1
    panels = []
    for word, each in poses.items():
        frames = json.dumps([str(drawn.shapes(pose)) for pose in each])
        picture = _svg(drawn.shapes(each[0]), words[word])
        panels.append(join(tag("div", picture, class_=f"{key}-panel"), Markup(f"<script>(window.films||={{}})['{key}']||=[];"
                      f"window.films['{key}'].push({frames})</script>")))  # fmt: skip
    moved = (
        f"const at=+this.value;document.querySelectorAll('.{key}-panel g').forEach((g,i)=>{{const f=films['{key}'][i];"
        f"g.innerHTML=f[Math.min(at,f.length-1)]}});this.nextSibling.textContent=(at/{RATE}).toFixed(2)+' s'"
    )
    slider = Markup(f'<input type="range" min="0" max="{last}" value="0" style="width:60%" aria-label="time" '
                    f'oninput="{moved}"><span> 0.00 s</span>')  # fmt: skip
    return tag("div", tag("div", *panels, class_="strip"), slider)


def orientation(poses: Mapping[str, Sequence[Sequence[float]]]) -> Markup:
    """The torso's lean in time: the robot, and the simulator before and after calibration (the paper's figure 5)."""
    colours = {"robot": INK, "file": BEFORE, "calibrated": AFTER}
    lines = {w: _lean(np.array(each)) for w, each in poses.items()}
    top = max(len(each) for each in lines.values())
    plot = Plot(
        (0.0, (top - 1) / RATE),
        span(np.concatenate(list(lines.values())).tolist()),
        "s",
        "lean of the torso, rad",
        height=230,
    )
    for word, lean in lines.items():
        plot.curve(np.arange(len(lean)) / RATE, lean, colours[word], width=2.2 if word == "robot" else 1.6)
    names = {"robot": "robot", "file": "model file", "calibrated": "calibrated"}
    legend = tag("p", *(tag("b", f"● {names[w]} ", style=f"color:{colours[w]}") for w in lines), class_="key")
    return join(plot.svg("lean of the torso in time"), legend)


def _lean(frames: Array) -> Array:
    """(T,) angle in rad between the torso and upright, forward positive as long as it is nearer to its feet than its head."""
    roll, pitch = frames[:, 3], frames[:, 4]
    angle = np.arccos(np.clip(np.cos(roll) * np.cos(pitch), -1.0, 1.0))
    return np.where((angle < 0.5 * np.pi) & (pitch < 0.0), -angle, angle)


def _svg(shapes: Markup, words: str) -> Markup:
    wide, high = 2 * _SIDE * _SCALE, (0.42 + _BELOW) * _SCALE
    floor = tag("line", x1=0, x2=wide, y1=0.42 * _SCALE, y2=0.42 * _SCALE, style="stroke:var(--rule)")
    word = tag("text", words, x=4, y=12, font_size="11", style="fill:var(--soft)")
    return tag("svg", floor, tag("g", shapes), word, viewBox=f"0 0 {wide:.0f} {high:.0f}", role="img", aria_label=words)


class Drawn:
    """The humanoid and what it sits or leans on, seen from its left, the far side paler."""

    def __init__(self, scene: str) -> None:
        model = model_of(scene)
        self._model, self._data = model.compiled, mujoco.MjData(model.compiled)
        self._places = [self._model.jnt_qposadr[self._model.joint(j).id] for j in model.names("actuator")]

    def shapes(self, pose: Sequence[float]) -> Markup:
        """One frame of `poses_of`."""
        model, data = self._model, self._data
        data.qpos[:3], data.qpos[3:7] = pose[:3], quaternion_of(np.array(pose[3:6]))
        data.qpos[self._places] = pose[6:]
        mujoco.mj_kinematics(model, data)
        order = sorted(range(model.ngeom), key=lambda g: float(data.geom_xpos[g, 1]))
        return join(*(_shape(model, data, g) for g in order if model.geom(g).name != "floor"))


def _shape(model: Any, data: Any, geom: int) -> Markup:
    name, size, centre = model.geom(geom).name, model.geom_size[geom], data.geom_xpos[geom]
    turned = data.geom_xmat[geom].reshape(3, 3)
    colour = "var(--faint)" if name == "support" or name.startswith("r_") else "var(--soft)"
    colour = "var(--ink)" if name == "torso" else colour
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE:
        (x1, y1), (x2, y2) = (_seen(centre + sign * size[1] * turned[:, 2]) for sign in (-1.0, 1.0))
        return tag("line", x1=f"{x1:.1f}", y1=f"{y1:.1f}", x2=f"{x2:.1f}", y2=f"{y2:.1f}", stroke_linecap="round",
                   style=f"stroke:{colour}", stroke_width=f"{2 * size[0] * _SCALE:.1f}")  # fmt: skip
    corners = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)]) * size
    outline = _hull(np.array([_seen(centre + turned @ corner) for corner in corners]))
    return tag("polygon", points=" ".join(f"{x:.1f},{y:.1f}" for x, y in outline), style=f"fill:{colour}")


def _seen(point: Array) -> tuple[float, float]:
    return (float(point[0]) + _SIDE) * _SCALE, (0.42 - float(point[2])) * _SCALE


def _hull(points: Array) -> Array:
    """Corners of the convex hull of (n, 2) points, in order (A. M. Andrew, Inf. Process. Lett. 9(5), 1979)."""
    halves = []
    for some in (points[np.lexsort(points.T)], points[np.lexsort(points.T)][::-1]):
        half: list[Array] = []
        for p in some:
            while len(half) > 1 and _turn(half[-1] - half[-2], p - half[-2]) <= 0.0:
                half.pop()
            half.append(p)
        halves += half[:-1]
    return np.array(halves)


def _turn(a: Array, b: Array) -> float:
    return float(a[0] * b[1] - a[1] * b[0])
