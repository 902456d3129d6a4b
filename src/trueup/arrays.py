# SPDX-License-Identifier: Apache-2.0
"""What arrays hold: numbers, truth values, whole numbers; shapes and units stand where each is named."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Integers = NDArray[np.int64]
