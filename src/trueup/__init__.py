# SPDX-License-Identifier: Apache-2.0
"""Makes a robot's simulator agree with the robot, from a handful of recordings.

The public names live in the modules that `_HOME` names and are imported when first used (PEP 562): `import trueup`
itself loads nothing heavy, so the command line answers at once.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # for type checkers and editors; the same names as in _HOME
    from trueup.calibration import Calibration as Calibration
    from trueup.errors import TrueupError as TrueupError

__version__ = "0.1.0"

_HOME = {
    "Calibration": "trueup.calibration",
    "TrueupError": "trueup.errors",
}
"""Public name -> module that defines it."""


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module 'trueup' has no attribute '{name}'; public names are: {', '.join(sorted(_HOME))}")
    value = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = value  # the next access does not come here
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
