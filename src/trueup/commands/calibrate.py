# SPDX-License-Identifier: Apache-2.0
"""`trueup calibrate`: recordings and a model in, a calibrated model, its parameters and a report out."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape

from trueup.calibration import Calibration, Lacked
from trueup.campaign.output import Output, fingerprint
from trueup.commands.between import (
    INTERPOLATED,
    add_between,
    sooner_than_held,
    what_is_between,
    with_commands_between,
)
from trueup.commands.console import notes, table_of, tell
from trueup.commands.progress import Watcher
from trueup.commands.show import proposal_line, show_outcome
from trueup.commands.sources import add_engine, add_refuse, add_shared, given, made_by, refusable, step_of, typed
from trueup.errors import ModelError, TrueupError
from trueup.formats.aside import write_aside
from trueup.recording import Recording
from trueup.report import replay_picture, write_report
from trueup.trial import STEP

if TYPE_CHECKING:
    from trueup.loop.calibrate import Options
    from trueup.loop.prepare import Preparation


ABOUT = """\
Finds the parameters of a robot model (MJCF or URDF) with which it replays the recordings, says how sure each one is,
and judges the result on recordings that were held out. In DIR you find the calibrated model, parameters.toml,
report.html (start there), replay.svg and calibration.json; where the recordings show what the model lacks,
parameters_lacking.toml has it, to be given back. Ctrl-C is fine: the same command goes on from there.

  trueup calibrate robot.xml logs/*.csv --hold-out fast --out fit
  trueup calibrate robot.xml logs/*.csv --hold-out 'walk_*' --parameters mine.toml --out fit
  trueup calibrate robot.xml log.csv --hold-out 30% --out fit       the last 30 % of each recording is held out
  trueup calibrate car.toml drives/*.csv --hold-out lap_3 --out fit

A car that is driven by throttle and steering, and whose pose was tracked, is a TOML file; the result is such a file too:

  [vehicle]
  wheelbase = 0.1735          # m

A path follower is tuned in fit/car.toml by `trueup new floor --from stanley` with [simulator] type = "vehicle" and
model = "../fit/car.toml" (docs/vehicles.md).

So is a robot on two driven wheels, commanded by these or by speed and turn rate (docs/vehicles.md):

  [vehicle]
  track = 0.23                # m, between the wheels
  wheel_radius = 0.033        # m; and counts_per_turn, of an encoder

A parameters file says what to calibrate, one table for each line; the result, fit/parameters.toml, is such a file too:

  [[parameter]]
  quantity = "friction"       # kp, kv, damping, armature, delay, backlash, mass, ...; a wrong name lists all
  of = "*"                    # names or patterns of joints, actuators or bodies
  tie = "each"                # or "all" (one value for all), or "mirror" (left and right share one)
  nominal = 0.1               # where to start; also lower, upper, scale = "log", frozen = true
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What this command takes."""
    parser.add_argument("model", metavar="MODEL", help="MJCF or URDF of the robot, or TOML of a car")
    add_shared(parser, "recordings", "hold-out", "mapping", "seed", "json", "quiet")
    parser.add_argument("--out", metavar="DIR", default="fit",
                        help="folder for the results; the next run takes DIR-2 (default: %(default)s)")  # fmt: skip
    parser.add_argument("--dry-run", action="store_true",
                        help="read everything, say what would be calibrated and from where to where, and stop")  # fmt: skip
    parser.add_argument("--parameters", metavar="FILE", help="what to calibrate (TOML); proposed if absent")
    parser.add_argument("--search", default="auto", choices=("auto", "gradient", "cma-es", "hybrid"),
                        help="gradient where it is smooth, cma-es where it is not (default: %(default)s)")  # fmt: skip
    parser.add_argument("--channels", metavar="LIST",
                        help="measured channels to fit, with commas (default: positions and sensors; velocity and torque "
                             "only if asked for, or if there is nothing else)")  # fmt: skip
    parser.add_argument("--beyond-mjcf", action="store_true",
                        help="try friction that grows with the load too, as small geared servos have it: about four times "
                             "the time; MJCF has no place for it, `trueup replay --parameters` has")  # fmt: skip
    parser.add_argument("--step", type=step_of, metavar="S",
                        help="integration step in s that you will simulate with (default: the model's own)")  # fmt: skip
    add_engine(parser)
    add_refuse(parser)
    add_between(parser)
    parser.add_argument("--choose", action="store_true",
                        help="before the fit, keep only those parameters on which replays hang and that the recordings "
                             "tell, and say why each was taken or left: for a file that declares much")  # fmt: skip
    parser.add_argument("--no-select", dest="select", action="store_false",
                        help="keep parameters that the recordings cannot support")  # fmt: skip
    parser.add_argument("--lacking", action=argparse.BooleanOptionalAction,
                        help="ask recordings what the model lacks (a dead band, gears that twist, springs), which can "
                             "double the time; without either, those of no more than a minute are asked")  # fmt: skip
    parser.add_argument("--force", action="store_true", help="start anew in DIR and replace what is there")


def run(args: argparse.Namespace, console: Console, told: Console) -> int:
    """Calibrates and writes the results. `console` takes the summary (or JSON), `told` progress and notes.

    Raises TrueupError, and KeyboardInterrupt after saying how to go on. Returns the exit code.
    """
    from trueup.loop.prepare import prepare

    training, held_out, found = _given(args, told)
    ready = prepare(args.model, training, held_out, parameters=args.parameters, beyond_mjcf=args.beyond_mjcf,
                    step=args.step, refuse=args.refuse, engine=args.engine)  # fmt: skip
    ready.check(_channels(args))
    if args.choose:
        ready, choice = ready.worthwhile(_channels(args), seed=args.seed)
        found = [*found, *choice.notes]
    family, simulator = ready.family, ready.simulator
    output = None if args.dry_run else _output(args, ready)
    if not args.quiet:
        more = (
            *ready.notes,
            *refusable(ready.diagnoses),
            *ready.unused(),
            *family.advice(simulator),
            *([output.note] if output and output.note else []),
        )
        notes(told, (*found, *more))
        told.print(escape(proposal_line(family.kinds(simulator), given=args.parameters is not None)), soft_wrap=True)
    if output is None:
        _show_proposal(ready, console)
        return 0
    with _going_on(args, output, told):
        calibration = _calibrated(args, ready, output, told)
        files, said = _write(args, output, ready, calibration)
    if args.json:
        console.print_json(output.outcome_file.read_text(encoding="utf-8"))
    else:
        show_outcome(calibration, console, quiet=args.quiet)
        notes(console, (*said, *family.advice(simulator, calibration), *_afterwards(args, ready, calibration)))
        for k, line in enumerate(ready.usage(calibration, output.model_file) if output.model_file in files else ()):
            tell(console, ("to simulate it as it was fitted:\n" if not k else "") + f"    {escape(line)}")
        tell(console, "  " + "  ".join(escape(str(f)) for f in files))
    return 0


def _given(args: argparse.Namespace, told: Console) -> tuple[list[Recording], list[Recording], list[str]]:
    """Recordings to fit and to judge by, with what is between the samples of commands, and notes."""
    training, held_out, found = given(args, told)
    if args.commands == INTERPOLATED:
        found = [*found, *what_is_between(training, args.commands, args.step or STEP)]
    first, second = (with_commands_between(rs, args.commands, args.step or STEP) for rs in (training, held_out))
    return first, second, list(found)


def _afterwards(args: argparse.Namespace, ready: Preparation, calibration: Calibration) -> tuple[str, ...]:
    """What the recordings say of a calibration beyond what it compared, and of how its commands are to be read."""
    from trueup.loop.logged_torques import beside_logged

    compared = [r.channel for r in calibration.replays]
    beside = beside_logged(ready.simulator, calibration.values, ready.recordings, compared)
    if args.commands == INTERPOLATED:
        then = "interpolate yours as well, where these lines hold them; trueup replay takes --commands interpolated"
        return (*beside, f"commands went from one sample to the next: {then}")
    return (*beside, *sooner_than_held(calibration, ready.recordings, args.step or STEP))


def _show_proposal(ready: Preparation, console: Console) -> None:
    """What would be calibrated, each from where, and within what."""
    table = table_of("parameter", "unit", "start", "lowest", "highest", words=("parameter", "unit"),
                     title="would be calibrated")  # fmt: skip
    for p in ready.simulator.parameters.parameters:
        if not p.frozen:
            table.add_row(escape(p.name), escape(p.unit), *(f"{v:.4g}" for v in (p.nominal, p.lower, p.upper)))
    console.print(table)
    fitted, judged = (", ".join(r.name for r in rows) or "none" for rows in (ready.recordings, ready.hold_out))
    tell(console, f"  fitted: {escape(fitted)}; held out: {escape(judged)}")


def _output(args: argparse.Namespace, ready: Preparation) -> Output:
    """The folder for the results of this calibration and no other."""
    model, parameters = Path(args.model), Path(args.parameters) if args.parameters else None
    choices = {"held out": [r.name for r in ready.hold_out], "search": args.search, "seed": args.seed,
               "select": args.select, "channels": args.channels, "beyond MJCF": args.beyond_mjcf,
               "step": args.step, **({"engine": args.engine} if args.engine else {}),
               **({"choose": True} if args.choose else {}),
               **({"refuse": sorted(args.refuse)} if args.refuse else {})}  # fmt: skip
    print_of = fingerprint(model, parameters, [*ready.recordings, *ready.hold_out], choices)
    return Output.open(Path(args.out), model, print_of, suffix=ready.family.suffix, force=args.force)


def _options(args: argparse.Namespace) -> Options:
    from trueup.loop.calibrate import Options

    return Options(
        search=args.search, select=args.select, seed=args.seed, channels=_channels(args), lacking=args.lacking
    )


def _channels(args: argparse.Namespace) -> tuple[str, ...] | None:
    return tuple(c.strip() for c in args.channels.split(",")) if args.channels else None


def _calibrated(args: argparse.Namespace, ready: Preparation, output: Output, told: Console) -> Calibration:
    resume: dict[str, Any] | None = dict(output.resume) if output.resume is not None else None
    with Watcher(told, _main_unit(ready.recordings), quiet=args.quiet) as watcher:
        return ready.calibrate(_options(args), progress=watcher, checkpoint=output.save, resume=resume)


@contextmanager
def _going_on(args: argparse.Namespace, output: Output, told: Console) -> Iterator[None]:
    """Says how to go on where this is interrupted; an empty folder is removed."""
    try:
        yield
    except KeyboardInterrupt:
        kept = output.state_file.is_file()
        where = f"the search is kept in {output.state_file}" if kept else "there was nothing to keep yet"
        same = "The same command without --force" if kept and args.force else "The same command"
        then = "goes on from there" if kept else "starts again"
        tell(told, escape(f"stopped; {where}. {same} {then}:\n  {typed(args)}"))
        output.discard()
        raise KeyboardInterrupt("how to go on was said") from None
    except TrueupError:
        output.discard()
        raise


def _main_unit(training: Sequence[Recording]) -> str:
    """The unit that the search speaks of: that of the positions where there are any."""
    for recording in training:
        if recording.has("position"):
            return recording.channel("position").unit
    return ""


def _write(
    args: argparse.Namespace, output: Output, ready: Preparation, calibration: Calibration
) -> tuple[list[Path], tuple[str, ...]]:
    """All result files; the plain numbers last, since they mark the folder as finished."""
    parameters, report = output.folder / "parameters.toml", output.folder / "report.html"
    try:
        notes = ready.write(calibration, output.model_file, parameters)
    except ModelError as error:  # minutes of search are in the rest
        notes = (f"the calibrated model could not be written: {error}. Its values are in {parameters}",)
    write_report(calibration, report, context=made_by(args))
    shown = [*calibration.held_out(), *calibration.training()]
    pictures = []
    if shown:
        pictures = [output.folder / "replay.svg"]
        write_aside(replay_picture(shown[0]), pictures[0])
    output.finish(calibration)
    driven = output.model_file.with_name(f"{output.model_file.stem}_driven{output.model_file.suffix}")
    written = [f for f in (output.model_file, driven, parameters, Lacked.beside(parameters)) if f.is_file()]
    return [*written, report, *pictures, output.outcome_file], notes
