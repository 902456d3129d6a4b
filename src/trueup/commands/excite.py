# SPDX-License-Identifier: Apache-2.0
"""`trueup excite`: an arm's model in, a trajectory out that identifies its dynamics and that the arm can perform."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.markup import escape

from trueup.campaign.output import free_folder
from trueup.commands.console import notes, tell
from trueup.commands.excite_summary import limits_table, show, used_of_limits
from trueup.commands.mounting import add_gravity, in_words, strange
from trueup.commands.progress import bar
from trueup.commands.sources import add_shared, typed
from trueup.errors import IdentificationError, MissingExtraError
from trueup.formats.aside import write_aside
from trueup.formats.plain import finite
from trueup.formats.trajectory import write_bag, write_csv, write_json
from trueup.report.trajectory_picture import trajectory_picture

if TYPE_CHECKING:
    from trueup.excitation.design import Step
    from trueup.excitation.excite import Outcome
    from trueup.excitation.expectation import Expected
    from trueup.excitation.problem import ExcitationProblem

ABOUT = """\
Designs the motion from which `trueup identify` learns an arm's dynamics: as informative as the joint limits allow, from
rest to rest, clear of collision with itself, the floor and what the model file places around it. In DIR you find
trajectory.csv, trajectory.json, a bag with a ROS JointTrajectory message, and path.svg (look there first).

  trueup excite arm.urdf --out excite                                  anywhere that is free, 30 s
  trueup excite arm.urdf --region cell.toml --via-points 8 --out excite   straight moves in a box, as programs make them
  trueup excite arm.urdf --limits limits.toml --duration 60 --out excite

A region file, in m and rad, in the model's base frame:

  link = "wrist_3_link"         # default: the last link that a joint moves
  tool = [0.0, 0.0, 0.12]       # the point on it that stays in the box; default: its origin
  [box]
  centre = [0.8, 0.0, 0.6]
  size = [0.4, 0.4, 0.3]
  [orientation]                 # for via points: how far the tool's z axis may lean, how far it may turn about it
  cone = 0.5
  spin = 0.5

A limits file replaces what the model says, or cannot say:

  [all]
  acceleration = 5.0            # rad/s^2; without it, top speed in 0.4 s
  [joints.elbow]
  torque = 150.0                # N m, nominal: the root mean square stays below; also lower, upper, speed
  peak = 350.0                  # N m, for short times (default: the nominal torque, times --peak)
"""

_FILES = ("trajectory.csv", "trajectory.json", "path.svg", "trajectory_bag")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What this command takes."""
    parser.add_argument("model", metavar="MODEL", help="URDF or MJCF of the arm")
    add_shared(parser, "out", "seed", "json", "force", "quiet")
    parser.add_argument("--region", metavar="FILE", help="box and cone in which the tool stays (TOML)")
    parser.add_argument("--motion", choices=("mix", "fourier", "sines", "via-points"),
                        help="a mix of classes and speeds (default), or the best of one class by --criterion")  # fmt: skip
    parser.add_argument("--via-points", type=int, metavar="N", help="straight moves through N poses of the region")
    parser.add_argument("--speed", type=float, default=1.0, metavar="V", help="m/s of those moves at most (default: 1)")
    parser.add_argument("--duration", type=float, metavar="S", help="of the whole, about (default: 30)")
    parser.add_argument("--criterion", choices=("D", "A", "E", "condition", "prediction"),
                        help="D: determinant; A: sum of variances; E: worst variance; condition: condition number; "
                             "prediction: torque error on random motions (default: D)")  # fmt: skip
    parser.add_argument("--friction", choices=("with", "without", "alone"),
                        help="whether friction parameters count, or count alone, in one class (default: with)")  # fmt: skip
    parser.add_argument("--percent", type=float, default=5.0, metavar="P",
                        help="how well each parameter is wanted (default: %(default)s %%)")  # fmt: skip
    parser.add_argument(
        "--after", metavar="DIR", help="folder of an identification of this arm: its errors are expected again"
    )
    parser.add_argument("--limits", metavar="FILE", help="joint limits that replace the model's (TOML)")
    parser.add_argument("--peak", type=float, default=1.0, metavar="R",
                        help="times the nominal torque that drives give for short times; the root mean square stays "
                             "below the nominal one (default: 1, the model's torque is a limit)")  # fmt: skip
    parser.add_argument("--lock", nargs="+", default=[], metavar="JOINT", help="joints that do not move")
    add_gravity(parser, " (default: as --after found it, or the model has it)")
    parser.add_argument(
        "--margin", type=float, default=2.0, metavar="CM", help="least clearance (default: %(default)s cm)"
    )
    parser.add_argument("--floor", default="auto", metavar="Z", help="height of the floor in m, 'none', or 'auto'")
    parser.add_argument("--rate", type=float, default=500.0, metavar="HZ", help="of trajectory.csv (default: 500)")
    parser.add_argument("--budget", type=float, default=20.0, metavar="S",
                        help="seconds of search within one class; a mix ends by a count (default: 20)")  # fmt: skip


def run(args: argparse.Namespace, console: Console, told: Console) -> int:
    """Designs, checks and writes a trajectory. Raises TrueupError. Returns the exit code."""
    from trueup.excitation.excite import excite
    from trueup.excitation.expectation import densities_of, expectations

    gravity, odd = _gravity(args)
    problem = _problem(args, gravity)
    density = densities_of(args.after, problem.criterion.model.tree.joints) if args.after else None
    folder = free_folder(Path(args.out), lambda at: args.force or not any((at / f).exists() for f in _FILES))
    moved = [f"results go to {folder}"] if folder != Path(args.out) else []
    notes(told, (*odd, *problem.notes, *moved), quiet=args.quiet)
    try:
        with _progress(told, args.budget, quiet=args.quiet) as watcher:
            outcome = excite(problem.criterion, problem.feasibility, problem.wish, problem.options, told=watcher)
    except KeyboardInterrupt:
        mixed = problem.wish.motion == "mix"  # which ends by a count
        sooner = "A shorter --duration, or one class (--motion fourier)," if mixed else "A smaller --budget"
        told.print(f"stopped; nothing was written. {sooner} ends sooner, with a result")
        raise KeyboardInterrupt("what ends sooner was said") from None
    expected = expectations(
        problem.criterion, outcome.trajectory, problem.feasibility.limits, density, percent=args.percent
    )
    numbers = _numbers(args, problem, outcome, expected)
    files, lost = _write(args, folder, problem, outcome, numbers)
    if args.json:
        console.print_json(data=numbers)
        return 0
    show(args, problem, outcome, expected, console)
    console.print(limits_table(problem, outcome))
    notes(console, (*outcome.notes, *lost), quiet=args.quiet)
    tell(console, "  " + "  ".join(escape(str(f)) for f in files))
    return 0


def _gravity(args: argparse.Namespace) -> tuple[tuple[float, ...] | None, list[str]]:
    """Gravity as it was given, or as an earlier identification of this arm had it; None where the model says; and notes."""
    if args.gravity is not None:
        return tuple(args.gravity), strange(args.gravity)
    if not args.after:
        return None, []
    from trueup.identification.model_file import load_tree
    from trueup.identification.torque_model import FILE, load

    if not (Path(args.after) / FILE).is_file():  # errors alone were handed on
        return None, []
    found = load(args.after).tree.gravity
    if np.array_equal(found, load_tree(args.model).gravity):
        return None, []
    return tuple(map(float, found)), [f"gravity is {in_words(found)}, as {args.after} was identified with (--gravity)"]


def _problem(args: argparse.Namespace, gravity: tuple[float, ...] | None) -> ExcitationProblem:
    """The arm, its limits and what is asked for. Raises IdentificationError for arguments that do not go together."""
    from trueup.excitation.problem import Asked, clearance_for, excitation_problem

    within = args.criterion or args.friction
    motion = args.motion or ("via-points" if args.via_points else "fourier" if within else "mix")
    if motion == "mix" and within:
        raise IdentificationError("--criterion and --friction belong to a search within one class: --motion fourier")
    if motion == "via-points" and not args.region:
        raise IdentificationError("--via-points needs a region for its poses: --region box.toml (`--help` shows one)")
    if args.via_points is not None and args.via_points < 3:
        raise IdentificationError(f"--via-points {args.via_points}: at least 3 are needed to make a path")
    for name in ("speed", "duration", "rate", "budget", "percent", "peak"):
        value = getattr(args, name)
        if value is not None and not 0.0 < value < math.inf:
            raise IdentificationError(f"--{name} {value:g}: a number above 0 is needed")
    if not args.peak >= 1.0:
        raise IdentificationError(
            f"--peak {args.peak:g}: drives give their nominal torque at least, 1 or more is needed"
        )
    asked = Asked(
        motion, args.region, args.limits, args.peak, tuple(args.lock), args.via_points or 6, args.speed, args.duration,
        args.criterion or "D", args.friction or "with", args.margin / 100.0, args.rate, args.budget, args.seed,
        gravity,
    )  # fmt: skip
    height = _height(args.floor)
    return excitation_problem(args.model, asked, lambda joints: clearance_for(args.model, joints, height))


def _height(given: str) -> float | str | None:
    if given in ("auto", "none"):
        return given if given == "auto" else None
    try:
        return float(given)
    except ValueError:
        raise IdentificationError(f"--floor {given}: choices are auto, none, or a height in m") from None


def _write(
    args: argparse.Namespace, folder: Path, problem: ExcitationProblem, outcome: Outcome, numbers: dict[str, Any]
) -> tuple[list[Path], list[str]]:
    """All files, and what could not be written for want of a package."""
    t, limits, lost = outcome.trajectory, problem.feasibility.limits, []
    files = [folder / name for name in _FILES]
    recording = t.recording({"command": typed(args)})
    write_csv(recording, files[0])
    cell = problem.feasibility.cell
    box = (
        None
        if cell is None
        else (cell.region.centre - 0.5 * cell.region.size, cell.region.centre + 0.5 * cell.region.size)
    )
    title = f"{problem.criterion.model.tree.name}: {t.duration:.1f} s of excitation ({problem.wish.motion})"
    write_aside(
        trajectory_picture(title, t.joints, t.time, t.q, t.qd, limits.speed, problem.chain.poses(t.q)[1], box), files[2]
    )
    try:
        write_bag(recording, files[3])
    except MissingExtraError as error:
        lost.append(f"no bag: {error}")
        files.pop()
    write_json(recording, files[1], numbers)
    return files, lost


def _numbers(
    args: argparse.Namespace, problem: ExcitationProblem, outcome: Outcome, expected: tuple[Expected, ...]
) -> dict[str, Any]:
    """The outcome as plain numbers, SI units."""
    t, limits = outcome.trajectory, problem.feasibility.limits
    return {
        "model": str(args.model), "motion": problem.wish.motion, "seed": args.seed, "duration": t.duration,
        "passes": list(outcome.passes), "log10_determinant_as_printed": outcome.excitation.printed,
        "criterion": args.criterion or "D", "mix": outcome.mix,
        "loss": outcome.excitation.loss, "seconds_of_search": outcome.excitation.seconds,
        "speed_shares": (np.abs(t.qd).max(axis=0) / limits.speed).round(4).tolist(),
        "acceleration_shares": (np.abs(t.qdd).max(axis=0) / limits.acceleration).round(4).tolist(),
        "clearance": finite(outcome.clearance), "nearest_parts": outcome.nearest,
        "limits": {name: finite(x.tolist()) for name, x in limits.values().items()},
        "limits_from": {name: list(x) for name, x in limits.sources.items()},
        "taken": {name: x.round(6).tolist() for name, x in used_of_limits(problem, outcome).items()},
        "starts_at": t.q[0].round(6).tolist(), "notes": [*problem.notes, *outcome.notes],
        "parameters": [
            {"name": e.leading, "combination": e.name, "unit": e.unit, "deviation": e.deviation,
             "percent": round(e.percent, 3),
             "value": finite(e.value), "advice": e.advice}
            for e in expected
        ],
    }  # fmt: skip


@contextmanager
def _progress(console: Console, budget: float, *, quiet: bool) -> Iterator[Callable[[Step], None]]:
    """What is called with each step of a search of `budget` s: a bar in a terminal, nothing elsewhere or with `quiet`."""
    with bar(console, quiet=quiet) as shown:
        task = shown.add_task("searching", total=1.0, said="")

        def watch(step: Step) -> None:
            said = f"{step.evaluations} motions" + (f", criterion {step.loss:.1f}" if math.isfinite(step.loss) else "")
            shown.update(task, completed=max(step.share, step.seconds / budget), said=said)

        yield watch
