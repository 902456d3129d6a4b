# SPDX-License-Identifier: Apache-2.0
"""UR10, real recording in a ROS bag: torque of the last 30 % predicted by what was fitted to the first 70 %."""

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from real_arm import arguments, data_folder, held_out

from trueup.formats import read
from trueup.identification.model_file import load_tree


def main() -> None:
    """Prints errors by joint and the result lines."""
    arguments(__doc__)
    folder = data_folder() / "ur10"
    urdf = folder / "ur10_robot.urdf"
    held_out("ur10", urdf, load_tree(urdf), read(folder / "bag_mcap"), goal=7.0)


if __name__ == "__main__":
    main()
