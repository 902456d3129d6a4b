# SPDX-License-Identifier: Apache-2.0
"""Films that are scrubbed, played and turned in a page: bodies and where they were, drawn by a small script."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trueup.errors import ParameterError
from trueup.film import Film
from trueup.formats.aside import write_aside
from trueup.report.encoding import packed
from trueup.report.markup import Markup, join, tag
from trueup.report.parts import Section, caption, page, template_text
from trueup.report.report import data_text

_AZIMUTH, _ELEVATION = 90.0, 8.0  # degrees as MuJoCo's camera has them: the robot's x axis points to the right


def film_replay(films: Sequence[Film]) -> Markup:
    """Films side by side with one slider, for any page; data and script are in it.

    Raises ParameterError for no film at all, and for films of different rates.
    """
    rates = {round(float(1.0 / np.diff(f.time).mean()), 6) for f in films if len(f.time) > 1}
    if len(rates) != 1:
        raise ParameterError(
            f"films that are shown side by side need one rate; these have {sorted(rates) or 'none'} Hz"
        )
    size = 1.25 * max(_size(f) for f in films)
    data = {
        "rate": rates.pop(), "size": size, "grid": 10.0 ** math.floor(math.log10(size / 2.0)),
        "azimuth": math.radians(_AZIMUTH), "elevation": math.radians(_ELEVATION), "films": [_described(f) for f in films],
    }  # fmt: skip
    shown = [
        tag("div", tag("div", f.name, class_="caption"), tag("canvas", aria_label=f"film: {f.name}",
            style="width:100%;height:320px;touch-action:none;cursor:grab"), style="flex:1 1 240px;min-width:0")
        for f in films
    ]  # fmt: skip
    controls = tag(
        "div", tag("button", "play", type="button"),
        tag("input", type="range", min="0", value="0", step="1", aria_label="instant", style="flex:1"), tag("output", "0 s"),
        style="display:flex;gap:12px;align-items:center",
    )  # fmt: skip
    row = tag("div", shown, style="display:flex;flex-wrap:wrap;gap:12px")
    given = tag("script", Markup(data_text(data)), type="application/json")
    return tag("figure", row, controls, given, tag("script", Markup(template_text("film.js"))), class_="film")


def write_film(films: Mapping[str, Sequence[Film]], path: str | os.PathLike[str], *, title: str) -> Path:
    """Writes a page with a replay for each run by name; complete, without a network. Raises OutputError, ParameterError."""
    sections = [
        Section(
            f"run-{k}", name, name, join(film_replay(shown), caption("Drag the slider, or the picture to turn it."))
        )
        for k, (name, shown) in enumerate(films.items())
    ]
    write_aside(page("campaign.html", title, (), sections), Path(path))
    return Path(path)


def _size(film: Film) -> float:
    """m: how far the hulls of the bodies that move reach over the whole run, seen from the body that is followed."""
    moving = np.ptp(film.position, axis=0).max(axis=1) > 0.0
    away = film.position[:, moving] - film.position[:, [film.followed]]
    return 2.0 * float(np.linalg.norm(away, axis=2).max(initial=0.1))


def _described(film: Film) -> dict[str, Any]:
    poses = np.concatenate([film.position, film.orientation], axis=2)
    shapes = [
        {
            "b": s.body,
            "p": np.round(s.points, 4).tolist(),
            "r": round(s.radius, 4),
            "c": [round(c, 2) for c in s.colour],
        }
        for s in film.shapes
    ]
    return {
        "name": film.name, "count": len(film.time), "bodies": film.position.shape[1], "floor": film.floor,
        "followed": film.followed, "shapes": shapes, "poses": packed(poses.ravel()),
    }  # fmt: skip
