# SPDX-License-Identifier: Apache-2.0
"""Franka Panda, real recording: torque of the last 30 % predicted by what was fitted to the first 70 %."""

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from real_arm import arguments, data_folder, held_out

from trueup.formats import read
from trueup.identification.estimation.matching import matched
from trueup.identification.model_file import load_tree


def main() -> None:
    """Prints errors by joint and the result lines."""
    arguments(__doc__)
    folder = data_folder() / "panda"
    urdf = folder / "panda.urdf"
    tree, (runs, _), notes = matched(load_tree(urdf), (read(folder), []))
    print(*notes, sep="\n")
    held_out("panda", urdf, tree, runs, goal=1.30)


if __name__ == "__main__":
    main()
