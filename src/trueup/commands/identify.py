# SPDX-License-Identifier: Apache-2.0
"""`trueup identify`: an arm's model and logs of position and torque in, a dynamic model that predicts torque out."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from trueup.campaign.output import free_folder
from trueup.commands.console import notes, tell
from trueup.commands.mounting import add_gravity, mounted
from trueup.commands.sources import SHARE, add_shared, given, made_by, mapping_for, recordings_in
from trueup.errors import IdentificationError, OutputError
from trueup.formats import ChannelMap, TimeColumn, guess_mapping
from trueup.formats.plain import write_json
from trueup.model_files.joint_names import joint_names
from trueup.recording import Recording

if TYPE_CHECKING:
    from trueup.identification.estimation.drives import Drives
    from trueup.identification.estimation.identify import Options
    from trueup.identification.estimation.result import Deliverable, Identification
    from trueup.identification.kinematic_tree import KinematicTree

ABOUT = """\
Finds the dynamic model of an arm (URDF or MJCF) from logs of joint positions and torques or motor currents: inertias,
rotors and friction, with standard deviations, judged on motion that was held out. In DIR you find

  report.html                     start there: how good each of these files is, read back from DIR
  torque.json                     all that was identified: trueup.load(DIR).torque(q, qd, qdd) in Python
  torque.h, torque.py             the same for a control loop: a C header, and a Python file that needs nothing
  the model file                  for simulators: bodies that can exist, rotors, Coulomb and viscous friction
  identification.json             all numbers and formulas

  trueup identify arm.urdf run1.csv run2.csv --hold-out run3.csv --out model
  trueup identify arm.urdf run.csv --hold-out 30% --out model            the last 30 % of each log is held out
  trueup identify arm.xml logs/*.csv --hold-out 'slow*' --drives drives.toml --out model

Logs of motor angles or currents need a drives file; leave out what is one to one:

  # How the columns of the log become joint positions and torques; leave out what is one to one.
  positions = "motor"          # "motor": angles before the gears; "joint" (the default): behind them
  torques = "motor"            # likewise

  [joints.joint_1]
  ratio = 32.0                 # turns of the motor for one of the joint; negative where it turns the other way
  offset = 0.0                 # rad, added to the joint's position
  torque_constant = 0.05       # N m/A at the motor (at the joint where torques = "joint"), for logs of currents
  spring = "strut"             # what balances it: "strut" (a coil spring or gas strut between two points), "torsion" (in
                               # proportion to the angle), or "none"

  [[couplings]]                # a motor that turns with a second joint too, as in many wrists
  drive = "joint_6"
  joint = "joint_5"
  ratio = 1.0                  # motor angle = ratio of joint_6 x (joint_6 + 1.0 x joint_5)
"""

_FILES = ("report.html", "identification.json", "torque.json", "torque.h", "torque.py")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What this command takes."""
    parser.add_argument("model", metavar="MODEL", help="URDF or MJCF of the arm")
    add_shared(parser, "recordings", "out", "hold-out", "mapping", "rate", "seed", "json", "force", "quiet")
    parser.add_argument("--drives", metavar="FILE", help="gear ratios, couplings, offsets, torque constants (TOML)")
    parser.add_argument("--payload", nargs="+", default=[], metavar="LOG",
                        help="runs with a known payload at the last link: torque constants from currents")  # fmt: skip
    parser.add_argument("--payload-mass", type=float, default=0.0, metavar="KG", help="its mass")
    parser.add_argument("--payload-com", nargs=3, type=float, metavar=("X", "Y", "Z"),
                        help="its centre of mass in the last link's frame, m (default: found too)")  # fmt: skip
    parser.add_argument(
        "--lock", nargs="+", default=[], metavar="JOINT", help="joints that do not move: welded at zero"
    )
    add_gravity(parser)
    parser.add_argument("--cutoff", type=float, metavar="HZ", help="of the filter (default: from the motion)")
    parser.add_argument("--align", default="auto", metavar="S",
                        help="shift of torque against position: auto (corrected where certain), off, or seconds")  # fmt: skip
    parser.add_argument("--friction", default="select", choices=("select", "paper", "common"),
                        help="select: by cross-validation; paper: f0 sign(v) + f1 v + f2 sign(v) v^2; common: Coulomb, "
                             "viscous, offset (default: %(default)s)")  # fmt: skip
    parser.add_argument("--gains", action="store_true",
                        help="give each joint's torque a scale of its own, where it is known in N m too")  # fmt: skip
    parser.add_argument("--torque", default="", metavar="WHICH",
                        help="the torque that is fitted, where a log holds several (measured, commanded, computed): a "
                             "channel or columns, as the message lists them")  # fmt: skip
    parser.add_argument("--refuse", nargs="+", action="extend", default=[], metavar="NAME",
                        help="disturbed: stretches in which something acted on the arm are not left out; lean: the base "
                             "stands as the model says, though torque says that it leans")  # fmt: skip
    parser.add_argument("--no-consistent", dest="consistent", action="store_false",
                        help="no physically possible bodies, and so no model file")  # fmt: skip


def run(args: argparse.Namespace, console: Console, told: Console) -> int:
    """Identifies and writes the results; `console` takes the summary or JSON, `told` progress and notes.

    Raises TrueupError. Returns the exit code.
    """
    from trueup.identification.estimation.drives import Drives
    from trueup.identification.estimation.identify import identify
    from trueup.identification.estimation.matching import matched
    from trueup.identification.model_file import load_tree

    options, names = _options(args)
    rated = None if args.rate is None else (lambda mapping: _with_rate(mapping, args.rate))
    training, held_out, found = given(args, told, hold_out=names, rated=rated, driven=False)
    whole, odd = mounted(load_tree(args.model), args.gravity)
    tree, (training, held_out), said = matched(whole, (training, held_out), args.torque, args.lock)
    drives = Drives.load(args.drives, whole.joints) if args.drives else Drives.direct(whole.joints)
    drives = drives.only(tree.joints)  # a file of all drives serves logs of some joints too
    if args.payload:
        drives, more = _weighed(args, tree, training, drives, rated)
        said = (*said, *more)
    folder = free_folder(Path(args.out), lambda at: _free(at, Path(args.model), force=args.force))
    elsewhere = [f"results go to {folder}"] if folder != Path(args.out) else []
    notes(told, (*odd, *found, *said, *elsewhere), quiet=args.quiet)
    progress = None if args.quiet else (lambda stage, share: tell(told, f"  {stage}"))
    result = identify(tree, training, held_out, drives=drives, options=options, told=progress)
    delivered, more = _write(args, result, folder)
    _show(args, result, delivered, more, folder, console)
    return 0


def _options(args: argparse.Namespace) -> tuple[Options, list[str]]:
    """The options, and what is held out by name."""
    from trueup.identification.estimation.identify import Options

    names, share = [], 0.0
    for entry in args.hold_out:
        if found := SHARE.fullmatch(entry):
            share = 0.01 * float(found[1])
        else:
            names.append(entry)
    align: str | float = args.align
    if align not in ("auto", "off"):
        try:
            align = float(args.align)
        except ValueError:
            raise IdentificationError(f"--align {args.align}: choices are auto, off, or a number of seconds") from None
    made = Options(cutoff=args.cutoff, align=align, hold_out=share, structure=args.friction,  # type: ignore[arg-type]
                   consistent=args.consistent, gains=args.gains, refuse=tuple(args.refuse), seed=args.seed)  # fmt: skip
    return made, names


def _weighed(
    args: argparse.Namespace,
    tree: KinematicTree,
    training: Sequence[Recording],
    drives: Drives,
    rated: Callable[[ChannelMap], ChannelMap] | None,
) -> tuple[Drives, tuple[str, ...]]:
    """The drives with torque constants from runs that carry a payload."""
    from trueup.identification.estimation.matching import matched
    from trueup.identification.estimation.payload import drives_from_payload, payload_inertial

    mapping, _ = mapping_for(args.mapping)
    named, joints, paths = args.mapping is not None, joint_names(args.model), [Path(path) for path in args.payload]
    known = mapping if rated is None else rated(ChannelMap.load(mapping) if mapping else guess_mapping(paths, joints))
    loaded, _ = recordings_in(paths, known, named=named, joints=joints)
    _, (loaded, _), _ = matched(tree, (loaded, []), args.torque, at_motors=drives.motor_positions)
    load = payload_inertial(args.payload_mass, args.payload_com)
    return drives_from_payload(tree, training, loaded, drives, load, cutoff=args.cutoff)


def _with_rate(mapping: ChannelMap, rate: float) -> ChannelMap:
    if not rate > 0.0:
        raise IdentificationError(f"--rate {rate:g}: samples per second must be above zero")
    return ChannelMap(mapping.channels, TimeColumn(rate=rate), mapping.joints, mapping.notes)


def _free(at: Path, model: Path, *, force: bool) -> bool:
    """Whether results may go to a folder. Raises OutputError where they were to replace the model that was given."""
    own = (at / model.name).resolve() == model.resolve()
    if own and force:
        raise OutputError(f"{at / model.name} is the model that was given; name another folder with --out")
    return not own and (force or not any((at / f).exists() for f in (*_FILES, model.name)))


def _write(
    args: argparse.Namespace, result: Identification, folder: Path
) -> tuple[Sequence[Deliverable], tuple[str, ...]]:
    """All result files; the plain numbers last, since they mark the folder as finished."""
    from trueup.identification.delivery.folder import deliver
    from trueup.identification.delivery.numbers import numbers_of
    from trueup.report.identification import write_identification_report

    delivered, lost = deliver(result, args.model, folder)
    write_identification_report(result, folder / _FILES[0], delivered=delivered, context=made_by(args))
    write_json(numbers_of(result, delivered), folder / _FILES[1])
    return delivered, lost


def _show(
    args: argparse.Namespace, result: Identification, delivered: Sequence[Deliverable], lost: Sequence[str], folder: Path,
    console: Console,
) -> None:  # fmt: skip
    from trueup.commands.show_identification import show_identification

    if args.json:
        console.print_json((folder / _FILES[1]).read_text(encoding="utf-8"))
        return
    show_identification(result, delivered, folder, console, quiet=args.quiet)
    notes(console, lost, quiet=args.quiet)
