# SPDX-License-Identifier: Apache-2.0
"""Pictures of the study's runs: film strips, a replay that one can scrub, the torso's orientation in time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from trueup.arrays import Array
from trueup.articulated.pose import ANGLES, AXES, ORIENTATION, POSITION
from trueup.engines.mujoco.filming import filmed, pictures
from trueup.errors import RenderingError
from trueup.recording import Channel, Recording
from trueup.report.film_replay import film_replay
from trueup.report.film_strip import film_strip
from trueup.report.markup import Markup, join, tag
from trueup.report.plots import AFTER, BEFORE, INK, Plot, span
from trueup.studies.balance.scenes import model_of

Frames = Sequence[Sequence[float]]

RATE = 25.0  # Hz
_PICTURES, _NEAR = 7, 0.85  # and m from the camera to the robot
WORDS = {
    "robot": "robot",
    "file": "simulator, model file",
    "calibrated": "simulator, calibrated",
    "fitted": "simulator, calibrated on it",
}
_COLOURS = {"robot": INK, "file": BEFORE, "calibrated": AFTER, "fitted": AFTER}


def poses_of(recording: Recording, joints: Sequence[str]) -> list[list[float]]:
    """Frames at `RATE`: x, y, z, roll, pitch, yaw and the joints in their order, rounded; from the motion's start."""
    time = np.arange(0.0, recording.channel(POSITION).time[-1] + 1e-9, 1.0 / RATE)
    angles = recording.channel(ORIENTATION)
    turned = angles.replace(values=np.unwrap(angles.values, axis=0))
    channels = (recording.channel(POSITION), turned, recording.channel("position").select(joints))
    frames = np.concatenate([c.at(time) for c in channels], axis=1)
    return np.round(frames[np.isfinite(frames).all(axis=1)], 4).tolist()


def strip(scene: str, runs: Mapping[str, Frames]) -> Markup:
    """Rows of pictures at the same instants, one a run: the paper's figures 3, 4, 6 and 7."""
    last = (min(len(each) for each in runs.values()) - 1) / RATE
    time = np.linspace(0.0, last, _PICTURES).tolist()
    try:
        rows = {
            WORDS[w]: pictures(model_of(scene), _recording(scene, w, each), time, distance=_NEAR)
            for w, each in runs.items()
        }
    except RenderingError as error:
        return tag("p", f"No film strip: {error}", class_="caption")
    return Markup(film_strip(rows, time, scene.replace("-", " ")))


def replay(scene: str, runs: Mapping[str, Frames]) -> Markup:
    """The runs side by side, moved by a slider."""
    lasting = (max(len(each) for each in runs.values()) - 1) / RATE
    return film_replay([
        filmed(model_of(scene), _recording(scene, w, each), name=WORDS[w], rate=RATE, lasting=lasting)
        for w, each in runs.items()
    ])  # fmt: skip


def orientation(runs: Mapping[str, Frames]) -> Markup:
    """How far the torso leans forward in time: the robot, and the simulator before and after (the paper's figure 5)."""
    lines = {w: _lean(np.array(each)) for w, each in runs.items()}
    top = max(len(each) for each in lines.values())
    plot = Plot(
        (0.0, (top - 1) / RATE),
        span(np.concatenate(list(lines.values())).tolist()),
        "s",
        "torso leans, rad",
        height=230,
    )
    for word, lean in lines.items():
        plot.curve(np.arange(len(lean)) / RATE, lean, _COLOURS[word], width=2.4 if word == "robot" else 1.6)
    legend = tag("p", [tag("b", f"● {WORDS[w]}\u2003", style=f"color:{_COLOURS[w]}") for w in lines], class_="key")
    return join(plot.svg("how far the torso leans forward in time"), legend)


def _recording(scene: str, name: str, frames: Frames) -> Recording:
    table, joints = np.array(frames), model_of(scene).names("actuator")
    time = np.arange(len(table)) / RATE
    channels = (
        Channel("position", joints, "rad", time, table[:, 6:]), Channel(POSITION, AXES, "m", time, table[:, :3]),
        Channel(ORIENTATION, ANGLES, "rad", time, table[:, 3:6]),
    )  # fmt: skip
    return Recording(name, {c.name: c for c in channels})


def _lean(frames: Array) -> Array:
    """(T,) angle in rad by which the torso leans the way that it faced at first, past upside down too."""
    roll, pitch, yaw = frames[:, 3:6].T - [[0.0], [0.0], [frames[0, 5]]]
    ahead = np.cos(yaw) * np.sin(pitch) * np.cos(roll) + np.sin(yaw) * np.sin(roll)
    return np.unwrap(np.arctan2(ahead, np.cos(pitch) * np.cos(roll)))
