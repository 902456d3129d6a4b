# SPDX-License-Identifier: Apache-2.0
"""What the benchmarks on real arms share: where the logs are, the peer's plain fit, and the lines they print."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from results import result
from yardstick import PINOCCHIO, pinocchio_seconds

from trueup.identification.estimation import identify as module
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.identify import Options, identify
from trueup.identification.estimation.result import Identification, relative_error
from trueup.identification.kinematic_tree import KinematicTree
from trueup.recording import Recording

Array = NDArray[np.float64]


def data_folder() -> Path:
    """The folder of recordings of real robots: TRUEUP_DATA, else shared/data beside the project."""
    said = os.environ.get("TRUEUP_DATA")
    folder = Path(said) if said else Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        raise SystemExit(f"no recordings of real robots in {folder}; set TRUEUP_DATA to their folder")
    return folder


def arguments(what: str | None) -> argparse.Namespace:
    """--quick is taken as every benchmark takes it; these are quick anyway."""
    parser = argparse.ArgumentParser(description=what)
    parser.add_argument("--quick", action="store_true", help="nothing is left out")
    return parser.parse_args()


def show(found: Identification, plain: Identification) -> None:
    """Errors by joint of ours, of ours with possible bodies, and of a plain fit."""
    print(f"{'joint':24s} ours %   possible bodies %   plain fit %     effects kept")
    rows = [_by_joint(found, "fitted"), _by_joint(found, "consistent"), _by_joint(plain, "fitted")]
    for j, joint in enumerate(found.joints):
        errors = "   ".join(f"{row[j]:10.2f}" for row in rows)
        print(f"{joint:24s}{errors}     {', '.join(found.structure[j])}")
    for name, which in (("fitted", found), ("plain fit", plain)):
        print(
            f"{name}: trained {100 * relative_error(which.training()):.3f} %, "
            f"held out {100 * relative_error(which.held_out()):.3f} %"
        )
    for sentence in found.warnings:
        print("mind:", sentence)


def _by_joint(found: Identification, which: str) -> Array:
    from trueup.identification.estimation.result import relative_errors

    return 100.0 * relative_errors(found.held_out(), which)


def held_out(name: str, tree: KinematicTree, runs: Sequence[Recording], *, goal: float) -> None:
    """The protocol of Panda and UR10: 10 Hz, the last 30 % held out; peer: Coulomb, viscous, offset, weighted, unaligned."""
    options = Options(cutoff=10.0, hold_out=0.3)
    found, seconds = timed_consistent(tree, runs, options)
    free = identify(tree, runs, options=replace(options, consistent=False))
    plain = identify(tree, runs, options=replace(options, structure="common", align="off", consistent=False))
    show(found, plain)
    peer = 100.0 * relative_error(plain.held_out())
    result(
        f"{name}_held_out_relative_percent", 100.0 * relative_error(found.held_out()), "%", goal,
        peer="weighted least squares with Coulomb, viscous, offset", peer_value=peer,
    )  # fmt: skip
    consistent_lines(name, found, free, seconds)


def timed_consistent(
    tree: KinematicTree, runs: Sequence[Recording], options: Options, drives: Drives | None = None
) -> tuple[Identification, float]:
    """The identification, and the CPU time in s that possible bodies took, the choice of their pull to the file included."""
    took: list[float] = []
    real = module.cross_validated_fit

    def timed(*given: Any) -> Any:
        begun = time.process_time()
        made = real(*given)
        took.append(time.process_time() - begun)
        return made

    with patch.object(module, "cross_validated_fit", timed):
        identify(tree, runs, drives=drives, options=options)  # once to warm up
        return identify(tree, runs, drives=drives, options=options), took[-1]


def consistent_lines(name: str, found: Identification, free: Identification, seconds: float) -> None:
    """What possible bodies cost against a fit that knows nothing of bodies, in accuracy and time."""
    possible, without = relative_error(found.held_out(), "consistent"), relative_error(free.held_out())
    print(f"unconstrained: held out {100 * without:.3f} %, possible bodies {100 * possible:.3f} %")
    result(f"{name}_consistent_over_unconstrained", possible / without, "", 1.02)
    result(f"{name}_consistent_seconds", seconds, "s", 1.0, peer=f"{PINOCCHIO}, a hundred thousand samples",
           peer_value=pinocchio_seconds(1e5), ratio_goal=True)  # fmt: skip
