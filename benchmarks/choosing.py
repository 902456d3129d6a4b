# SPDX-License-Identifier: Apache-2.0
"""Parameters chosen by what they are worth, beside the paper's fixed 30 and all that may be wrong: torso in motions left out.

Stand-ins of the small humanoid in DART, whose truth is of another structure, rise from a chair twice by the first guess of
that motion. The simulator in MuJoCo is calibrated on this with the fixed 30, with all of `wider.toml`, and with those that
`worth_calibrating` takes of these, all in the same way. Judged is the torso's orientation in another motion from the chair
and in leaning to standing.
"""

from __future__ import annotations

import argparse
import os
import time

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from numpy.typing import NDArray
from results import result

from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.loop.whole_runs import whole_runs
from trueup.loop.worth import worth_calibrating
from trueup.studies.balance.calibration import STEP, Runs, declared
from trueup.studies.balance.campaign import performed
from trueup.studies.balance.robot import StandInHumanoid
from trueup.studies.balance.scenes import model_of, transition

Array = NDArray[np.float64]

FITTED, OTHER = "sit-to-stand", "lean-to-stand"


def simulator(scene: str, names: tuple[str, ...], of: str) -> MujocoSimulator:
    """The scene's simulator with some of the parameters of a file alone."""
    space, quantities = declared(scene, of)
    kept = [i for i, n in enumerate(space.names) if n in names]
    some = type(space)(tuple(space.parameters[i] for i in kept))
    return MujocoSimulator(model_of(scene), some, tuple(quantities[i] for i in kept), step=STEP)


def runs_of(number: int) -> tuple[Runs, tuple[Runs, ...]]:
    """What a stand-in does: a motion that is fitted, and two that judge."""
    found = []
    for scene, moved in ((FITTED, 0.0), (FITTED, 0.06), (OTHER, 0.0)):
        _, task = transition(scene, step=STEP)
        space = task.parameters
        begun = space.to_unit(space.nominal)
        motion = space.from_unit(
            np.clip(begun + moved * np.random.default_rng(number).standard_normal(len(begun)), 0.0, 1.0)
        )
        recordings, stood = performed(StandInHumanoid(scene, number), task, motion, f"{scene} {moved:g}", 2)
        print(f"stand-in {number}, {scene}: {sum(stood)} of {len(stood)} stood", flush=True)
        found.append(Runs(scene, recordings, task.trials[0].ends))
    return found[0], tuple(found[1:])


def error(names: tuple[str, ...], of: str, fitted: Runs, judged: tuple[Runs, ...]) -> tuple[float, float]:
    """The torso's error in motions left out, in rad, with parameters by name, calibrated on `fitted`, and CPU seconds."""
    begun, made = time.process_time(), simulator(fitted.scene, names, of)
    found = whole_runs([fitted.problem(made)], made.parameters, seed=0, generations=4, members=1, descents=4)
    errors = [r.error(simulator(r.scene, names, of), found.values[0]) for r in judged]
    return float(np.sqrt(np.mean(np.square(errors)))), time.process_time() - begun


def main() -> None:
    """Prints the errors of all three sets for each stand-in."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one stand-in")
    numbers = range(1) if parser.parse_args().quick else range(5)
    errors, counts, several = [], [], 0
    for number in numbers:
        fitted, judged = runs_of(number)
        wide, fixed = (declared(fitted.scene, of)[0] for of in ("wider", "parameters"))
        several = len(wide)
        whole = simulator(fitted.scene, wide.names, "wider")
        choice = worth_calibrating([fitted.problem(whole)], whole.parameters, rng=np.random.default_rng(number))
        print("\n".join(choice.notes), flush=True)
        raw = float(
            np.sqrt(np.mean([r.error(simulator(r.scene, wide.names, "wider"), wide.nominal) ** 2 for r in judged]))
        )
        rows = [(raw, 0.0), *(error(names, of, fitted, judged) for names, of in
                              ((fixed.names, "parameters"), (wide.names, "wider"), (choice.chosen, "wider")))]  # fmt: skip
        print(f"stand-in {number}: torso in motions left out: as it came {raw:.3f} rad; fixed {len(fixed)} {rows[1][0]:.3f}; "
              f"all {len(wide)} {rows[2][0]:.3f}; chosen {len(choice.chosen)} {rows[3][0]:.3f}; CPU s "
              f"{', '.join(f'{s:.1f}' for _, s in rows[1:])}", flush=True)  # fmt: skip
        errors.append([e for e, _ in rows])
        counts.append(len(choice.chosen))
    mean = np.exp(np.log(errors).mean(axis=0))
    result("chosen_torso_error", mean[3], "rad", 1.0, peer="the paper's fixed 30", peer_value=mean[1], ratio_goal=True)
    result("chosen_against_all", mean[3], "rad", 1.0, peer="all of wider.toml", peer_value=mean[2], ratio_goal=True)
    result("chosen_parameters", float(np.mean(counts)), f"of {several}", 30.0)


if __name__ == "__main__":
    main()
