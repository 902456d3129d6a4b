# SPDX-License-Identifier: Apache-2.0
"""What others add: names that installed packages register, and 'module:attribute' of a module beside a file."""

from __future__ import annotations

import importlib
import importlib.metadata
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from trueup.errors import TrueupError


def version() -> str:
    """That of trueup itself."""
    try:
        return importlib.metadata.version("trueup")
    except importlib.metadata.PackageNotFoundError:
        return "(not installed)"


def registered(group: str) -> dict[str, str]:
    """Name to 'module:attribute' of the entry points of one group ('trueup.robots')."""
    return {e.name: e.value for e in importlib.metadata.entry_points(group=group)}


def addressed(address: str, base: Path, broken: Callable[[str], TrueupError]) -> Any:
    """What 'module:attribute' names; the module is installed or lies in the folder `base`.

    Raises what `broken` makes of a sentence that says what is missing.
    """
    module_name, _, attribute = address.partition(":")
    target = _module(module_name, base, broken)
    for part in attribute.split("."):
        if not hasattr(target, part):
            raise broken(f"module '{module_name}' ({getattr(target, '__file__', '?')}) has no '{attribute}'")
        target = getattr(target, part)
    return target


def _module(name: str, base: Path, broken: Callable[[str], TrueupError]) -> Any:
    folder = str(base.resolve())
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name not in (name, name.partition(".")[0]):
            raise broken(f"module '{name}' needs '{error.name}', which is not installed") from error
        raise broken(f"there is no module '{name}', neither installed nor in {base}") from None
