# SPDX-License-Identifier: Apache-2.0
"""The part of Clarabel that trueup uses: it ships no types."""

from collections.abc import Sequence

from numpy.typing import NDArray
from scipy.sparse import csc_matrix

class DefaultSettings:
    verbose: bool
    tol_gap_abs: float
    tol_gap_rel: float
    tol_feas: float

class PSDTriangleConeT:
    def __init__(self, dim: int) -> None: ...

class NonnegativeConeT:
    def __init__(self, dim: int) -> None: ...

class DefaultSolution:
    status: object
    x: list[float]

class DefaultSolver:
    def __init__(
        self, P: csc_matrix, q: NDArray, A: csc_matrix, b: NDArray, cones: Sequence[object], settings: DefaultSettings
    ) -> None: ...
    def solve(self) -> DefaultSolution: ...
