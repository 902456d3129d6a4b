# SPDX-License-Identifier: Apache-2.0
"""Names of the joints in a model file, as its text has them: enough to know them again in the columns of a log."""

from __future__ import annotations

from pathlib import Path

from trueup.errors import ModelError
from trueup.model_files.urdf import parsed

_XML = (".xml", ".mjcf", ".urdf")
_VEHICLE = ".toml"


def joint_names(path: str | Path) -> tuple[str, ...] | None:
    """Joints of an MJCF (with the files that it includes) or a URDF, without those that are fixed; None of a vehicle's TOML
    file, which has none; () for other files.

    Nothing is raised: whoever loads the model says what is wrong with it.
    """
    if Path(path).suffix.lower() == _VEHICLE:
        return None
    return tuple(dict.fromkeys(_names(Path(path), Path(path).parent, frozenset())))


def _names(path: Path, folder: Path, above: frozenset[Path]) -> list[str]:
    if path.suffix.lower() not in _XML or path in above:
        return []
    try:
        root = parsed(path)
    except ModelError:
        return []
    names = [j.get("name", "") for j in root.iter("joint") if j.get("type") != "fixed"]
    for include in root.iter("include"):
        names += _names(folder / include.get("file", ""), folder, above | {path})
    return [name for name in names if name]
