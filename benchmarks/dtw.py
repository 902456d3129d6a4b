# SPDX-License-Identifier: Apache-2.0
"""Time warping of two 8500-sample paths in a 10 % band, cost and matched points, beside dtaidistance and tslearn."""

from __future__ import annotations

import argparse
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from results import result

from trueup.discrepancies.dtw import dtw, dtw_path

Array = NDArray[np.float64]

_BAND = 0.1


def paths(samples: int) -> tuple[Array, Array]:
    """(samples, 2) a wandering path, and the same one driven by a robot that strays from it."""
    rng = np.random.default_rng(0)
    first = np.cumsum(rng.normal(0.0, 0.01, (samples, 2)), axis=0)
    return first, first + np.cumsum(rng.normal(0.0, 0.002, (samples, 2)), axis=0)


def milliseconds(action: Callable[[], object], repeats: int) -> float:
    """The least CPU time of some repeats, after one to compile."""
    action()
    spent = []
    for _ in range(repeats):
        began = time.process_time()
        action()
        spent.append(time.process_time() - began)
    return 1e3 * min(spent)


def main() -> None:
    """Prints a table, all with squared distances as dtaidistance has them, and two RESULT lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="2000 samples, fewer repeats")
    options = parser.parse_args()
    samples = 2000 if options.quick else 8500
    repeats = 3 if options.quick else 7
    a, b = paths(samples)
    radius = int(_BAND * (samples - 1))

    from dtaidistance import dtw_ndim
    from tslearn.metrics import dtw as tslearn_dtw
    from tslearn.metrics import dtw_path as tslearn_path

    ours = dtw(a, b, band=_BAND, squared=True) ** 0.5
    rows: dict[str, tuple[Callable[[], object], int]] = {
        "trueup cost": (lambda: dtw(a, b, band=_BAND, squared=True), repeats),
        "trueup cost, Euclidean": (lambda: dtw(a, b, band=_BAND), repeats),
        "trueup path": (lambda: dtw_path(a, b, band=_BAND, squared=True), repeats),
        "dtaidistance cost": (lambda: dtw_ndim.distance_fast(a, b, window=radius + 1), repeats),
        "tslearn cost": (lambda: tslearn_dtw(a, b, global_constraint="sakoe_chiba", sakoe_chiba_radius=radius), 2),
        "tslearn path": (lambda: tslearn_path(a, b, global_constraint="sakoe_chiba", sakoe_chiba_radius=radius), 2),
    }
    peers = (
        dtw_ndim.distance_fast(a, b, window=radius + 1),
        tslearn_dtw(a, b, global_constraint="sakoe_chiba", sakoe_chiba_radius=radius),
    )
    print(f"{samples} samples, band {radius}: cost {ours:.9g}; dtaidistance {peers[0]:.9g}, tslearn {peers[1]:.9g}")
    spent = {name: milliseconds(action, times) for name, (action, times) in rows.items()}
    for name, value in spent.items():
        print(f"{name:24s} {value:9.2f} ms")
    result("banded_8500", spent["trueup cost"], "ms CPU", 0.73, peer="dtaidistance",
           peer_value=spent["dtaidistance cost"], ratio_goal=True)  # fmt: skip
    result("banded_path_8500", spent["trueup path"], "ms CPU", 0.73, peer="dtaidistance, cost only",
           peer_value=spent["dtaidistance cost"], ratio_goal=True)  # fmt: skip


if __name__ == "__main__":
    main()
