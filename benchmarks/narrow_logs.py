# SPDX-License-Identifier: Apache-2.0
"""What a model fitted to a narrow log is worth on motion of other kinds, beside the plain form (Coulomb, viscous, offset).

The arms of `strange_arms`, each with six logs of one kind of motion of 25 s; ten motions of five classes judge, by the
root mean square error over nominal torque. Real arms: a third of the log is fitted, the other two judge. What the kinds
of motion earn that are left out is shown by the same fits with blocks of time in their place.
"""

from __future__ import annotations

import argparse
import itertools
import os
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import patch

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
import tx40
from real_arm import data_folder
from results import result
from strange_arms import _NOMINAL, _RATIOS, Arm, drawn

from trueup.arrays import Array
from trueup.errors import IdentificationError
from trueup.excitation.limits import JointLimits
from trueup.excitation.mixture import GENTLE, Draw, Moves, Series, wide_classes
from trueup.excitation.periodic import Fourier, Sines
from trueup.excitation.trajectories import Trajectory
from trueup.formats import read
from trueup.identification.estimation import identify as module
from trueup.identification.estimation import modelled
from trueup.identification.estimation.blocks import blocks_of, numbered
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.identify import Options, identify
from trueup.identification.estimation.motion import Piece
from trueup.identification.estimation.pool import Pool
from trueup.identification.estimation.result import relative_error
from trueup.identification.estimation.selection import TIME_BLOCKS
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.model_file import load_tree
from trueup.identification.rows import Rows
from trueup.recording import Channel, Recording

_SECONDS = 25.0
_SHORT = 9.0
_EARNED = 0.8
"""Of the plain form's error: what a richer form has to earn in the mean, for what it risks on single logs."""


@dataclass(frozen=True, eq=False)
class Case:
    """A narrow log, and what judges."""

    name: str
    tree: KinematicTree
    narrow: Recording
    others: tuple[Recording, ...]
    size: Array | None
    """(n,) N m, over which errors are taken; None: that of the torques that judge."""
    options: Options
    drives: Drives | None = None

    def error(self, options: Options) -> float:
        """Root mean square error of all joints and motions that judge, as a share of their size."""
        found = identify(self.tree, [self.narrow], self.others, drives=self.drives, options=options).held_out()
        if self.size is None:
            return relative_error(found)
        errors = np.concatenate([p.measured - p.fitted for p in found]) / self.size
        return float(np.sqrt(np.mean(errors**2)))


def simulated(number: int) -> Iterator[Case]:
    """The narrow logs of arm `number`, strange as its number modulo five says, with one motion of each class that judges."""
    with tempfile.TemporaryDirectory() as folder:
        arm = drawn(number, Path(folder))
        tree = load_tree(arm.file)
    arm, rng = replace(arm, number=number % 5), np.random.default_rng([number, 7])
    limits = JointLimits.of(tree).within(range_share=0.95)
    home = 0.5 * (limits.lower + limits.upper)
    classes = {**wide_classes(limits, home, length=6.0), **_more_classes(limits.within(range_share=0.8), limits, home)}
    others = tuple(_recorded(arm, _drawn(draw, rng), f"{name} {k}") for name, draw in classes.items() for k in range(2))
    slow = replace(limits.within(range_share=0.5), speed=0.25 * limits.speed, acceleration=0.1 * limits.acceleration)
    part = limits.within(range_share=0.3)
    narrow: dict[str, Draw] = {
        "slow series": Series(Fourier(slow, 20.0, 4), limits, home),
        "slow moves": classes["slow moves"],
        "part of the range": Moves(limits, part, home, GENTLE),
        "few moves": Moves(limits, limits.within(range_share=0.8), home, GENTLE, points=3),
        "fast sines": classes["sines"],
        "one short series": Series(Fourier(limits.within(range_share=0.6), 8.0, 4), limits, home),
    }
    for kind, draw in narrow.items():
        log = one = _drawn(draw, rng)
        while log.duration < (_SHORT if "short" in kind else _SECONDS):
            log = log.then(one if kind in ("slow series", "few moves") else _drawn(draw, rng))
        yield Case(f"{number} {kind}", tree, _recorded(arm, log, kind), others, _NOMINAL, Options())


def _more_classes(around: JointLimits, limits: JointLimits, home: Array) -> dict[str, Draw]:
    """Sums of sines over as much of the ranges as 7.5 s allow, and moves that creep."""
    longest = 7.5
    w = 3.0 * np.pi / longest
    reach = np.minimum(0.5 * (limits.upper - limits.lower), np.minimum(limits.acceleration / w**2, limits.speed / w))
    sines = Sines(around, reach=np.minimum(reach, np.pi), longest=longest)
    slow = Moves(limits, around.within(range_share=0.3), home, GENTLE, speeds=(0.03, 0.3))
    return {"sines": Series(sines, limits, home), "slow moves": slow}


def _drawn(draw: Draw, rng: np.random.Generator) -> Trajectory:
    """The first draw that can be performed."""
    return next(t for _ in range(200) if (t := draw(rng)) is not None)


def _recorded(arm: Arm, motion: Trajectory, name: str) -> Recording:
    """The log of a motion at 250 Hz: positions in steps of encoders, torque, of odd arms current of unknown constants."""
    torque, kept = arm.torque(motion.time, motion.q, motion.qd, motion.qdd), slice(None, None, 2)
    step = 2.0 * np.pi / 4096.0 / _RATIOS
    source, unit = ("current", "A") if arm.number % 2 else ("torque", "N m")
    parts = (("position", "rad", np.round(motion.q / step) * step), (source, unit, torque))
    return Recording(name, {k: Channel(k, arm.tree.joints, u, motion.time[kept], v[kept]) for k, u, v in parts})


def real() -> Iterator[Case]:
    """The thirds of the logs of three arms, in time."""
    data, usual = data_folder(), Options(cutoff=10.0)
    yield from _thirds("ur10", load_tree(data / "ur10" / "ur10_robot.urdf"), read(data / "ur10" / "bag_mcap")[0], usual)
    yield from _thirds("panda", load_tree(data / "panda" / "panda.urdf"), read(data / "panda")[0], usual)
    tree = load_tree(data / "tx40" / "tx40_mdh_modified.urdf")
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "drives.toml"
        file.write_text(tx40.drives_text(tree))
        drives = Drives.load(file, tree.joints)
    yield from _thirds("tx40", tree, read(data / "tx40", tx40.mapping())[0], Options(cutoff=100.0), drives)


def _thirds(
    name: str, tree: KinematicTree, log: Recording, options: Options, drives: Drives | None = None
) -> Iterator[Case]:
    """Each third of the moving part of a log by itself, judged on the other two."""
    place = log.channel("position")
    moved = np.abs(np.diff(place.values, axis=0)).max(axis=1)
    moving = place.time[1:][moved > 0.1 * np.quantile(moved, 0.99)]
    edges = np.linspace(moving[0], moving[-1], 4)
    parts = [log.slice(a, b).replace(name=f"third {k}") for k, (a, b) in enumerate(itertools.pairwise(edges), 1)]
    for part in parts:
        others = tuple(other for other in parts if other is not part)
        yield Case(f"{name} {part.name}", tree, part, others, None, options, drives)


def _blocks(_: Pool, pieces: Sequence[Piece]) -> list[Rows]:
    """Blocks of time in the place of kinds of motion."""
    rows = [p.rows for p in pieces if not p.held_out]
    return blocks_of(rows, numbered(rows, TIME_BLOCKS), 0.0)


def main() -> None:
    """Prints a row for each log and the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two arms")
    parser.add_argument("--only", type=int, nargs="*", help="numbers of arms")
    options = parser.parse_args()
    numbers = options.only if options.only is not None else list(range(20, 22 if options.quick else 25))
    refused = 0
    print("log                            error   over that of the plain form   over that by blocks alone", flush=True)
    for what, cases in (("simulated", (c for number in numbers for c in simulated(number))), ("real", real())):
        ratios = []
        for case in cases:
            try:
                ours, plain = (case.error(o) for o in (case.options, replace(case.options, structure="common")))
                with patch.object(module, "kinds_of", _blocks), patch.object(modelled, "kinds_of", _blocks):
                    blocks = case.error(case.options)
            except IdentificationError as error:
                refused += 1
                print(f"{case.name:28s}refused: {error}", flush=True)
                continue
            ratios.append((ours / plain, ours / blocks))
            print(f"{case.name:28s}{100 * ours:7.3f} %{ratios[-1][0]:20.3f}{ratios[-1][1]:28.3f}", flush=True)
        mean, worst = np.exp(np.mean(np.log(ratios), axis=0)), np.max(ratios, axis=0)
        print(f"{what:28s} mean{mean[0]:24.3f}{mean[1]:28.3f}, at worst {worst[0]:.3f} and {worst[1]:.3f}")
        result(f"narrow_logs_{what}_over_plain", float(mean[0]), "", _EARNED, peer="plain form, possible bodies")
        result(f"narrow_logs_{what}_over_plain_at_worst", float(worst[0]), "", 1.0, peer="plain form, possible bodies")
    result("narrow_logs_refused", refused, "", 0)


if __name__ == "__main__":
    main()
