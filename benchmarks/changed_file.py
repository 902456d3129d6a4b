# SPDX-License-Identifier: Apache-2.0
"""A model file that is wrong in some places, for hidden robots."""

from __future__ import annotations

from pathlib import Path

from trueup.engines.mujoco.model import Model, load


def changed(file: Path, folder: Path, *pieces: tuple[str, str]) -> Model:
    """The model of a file in whose text each old piece, which stands there once, is a new one."""
    text = file.read_text("utf-8")
    for old, new in pieces:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = folder / "hidden.xml"
    path.write_text(text, encoding="utf-8")
    return load(path)
