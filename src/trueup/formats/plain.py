# SPDX-License-Identifier: Apache-2.0
"""Values as strict JSON can hold them: no NaN, no infinity, no numpy."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from trueup.formats.aside import write_aside


def finite(value: Any) -> Any:
    """The same value in Python's own types, nested ones included; numbers that are not finite become None."""
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, dict):
        return {k: finite(v) for k, v in value.items()}
    return [finite(v) for v in value] if isinstance(value, list | tuple) else value


def write_json(value: Any, path: Path) -> None:
    """Writes a value as a file of strict JSON, aside and renamed. Raises OutputError."""
    write_aside(json.dumps(finite(value), indent=1, allow_nan=False) + "\n", path)
