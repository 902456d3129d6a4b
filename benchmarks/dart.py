# SPDX-License-Identifier: Apache-2.0
"""DART as an engine of trueup: a standing humanoid under its servos, beside dartpy's own loop over the same worlds."""

from __future__ import annotations

import argparse
import os
import time

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from numpy.typing import NDArray
from results import result

from trueup.articulated.model import BasePose
from trueup.engines.dart.copies import LONGEST, DartCopies, ServoLaw
from trueup.engines.dart.model import DartModel, of
from trueup.studies.balance.scenes import STAND, model_of, pose_of

Array = NDArray[np.float64]

ROBOTS, STEP = 32, 0.002


def standing(model: DartModel) -> tuple[DartCopies, Array]:
    """Robots that stand, and the commands (b, width) that keep them so."""
    joints = model.names("actuator")
    angles = dict(zip(joints, pose_of(joints, STAND), strict=True))
    copies, still = model.copies(ROBOTS), np.zeros(3)
    place = np.array([angles[a] for a in model.drives().values()])
    copies.place(
        np.tile(place, (ROBOTS, 1)),
        np.zeros((ROBOTS, len(place))),
        BasePose(np.array([0.0, 0.0, 0.302]), still, still, still),
    )
    command = np.zeros((ROBOTS, model.width))
    for joint, column in model.columns().items():
        command[:, column] = angles[joint]
    return copies, command


def recorded(copies: DartCopies, command: Array, count: int) -> list[Array]:
    """The forces (b, dofs) of each substep on the way: with these the plain loop meets the same contacts."""
    kept: list[Array] = []
    given = copies._forces  # pyright: ignore[reportPrivateUsage]

    def forces(law: ServoLaw) -> Array:
        kept.append(np.array(given(law)))
        return kept[-1]

    copies._forces = forces  # type: ignore[method-assign]
    for _ in range(count):
        copies.step(command, STEP)
    return kept


def main() -> None:
    """Prints steps a second of both, and the share."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a fifth of the steps")
    count = 50 if parser.parse_args().quick else 250
    model = of(model_of("kneel-to-stand"))
    inner = round(STEP / LONGEST)
    rehearsed, command = standing(model)
    forces = recorded(rehearsed, command, count)
    (copies, _), (plain, _) = standing(model), standing(model)
    for world in plain.worlds:
        world.setTimeStep(STEP / inner)
    times = np.zeros(2)
    for k in range(count):  # in turns, so that whatever else runs disturbs both alike
        begun = time.process_time()
        copies.step(command, STEP)
        between = time.process_time()
        for given in forces[k * inner : (k + 1) * inner]:
            for world, robot, force in zip(plain.worlds, plain.robots, given, strict=True):
                robot.setForces(force)
                world.step()
        times += between - begun, time.process_time() - between
    apart = max(
        float(np.abs(a.getPositions() - b.getPositions()).max())
        for a, b in zip(copies.robots, plain.robots, strict=True)
    )
    print(f"both end in the same state, to {apart:.1g} rad")
    ours, theirs = (count * inner * ROBOTS / times).tolist()
    print(
        f"{ROBOTS} humanoids, steps of {1e3 * LONGEST:g} ms: {ours:.0f} steps a CPU second, dartpy's own loop {theirs:.0f}"
    )
    result(
        "dart_steps_per_second",
        ours,
        "1/s",
        0.9,
        peer="dartpy's own loop",
        peer_value=theirs,
        at_most=False,
        ratio_goal=True,
    )


if __name__ == "__main__":
    main()
