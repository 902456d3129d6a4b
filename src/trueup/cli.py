# SPDX-License-Identifier: Apache-2.0
"""The command `trueup`: reads the command line, runs a command of trueup.commands, prints errors as one message."""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

_OK, _ERROR, _USAGE, _INTERRUPTED = 0, 1, 2, 130

_ABOUT = """\
Makes a robot's simulator agree with the robot, from a handful of recordings.

  trueup inspect logs/*.csv --model robot.xml        what is in the logs; writes mapping.toml
  trueup calibrate robot.xml logs/*.csv --hold-out fast --out fit
  trueup demo                                        the whole, on a simulated arm, nothing needed
"""

_INSPECT = """\
Looks at recordings: rate, gaps, jitter, channels and units, encoder grid, noise, what does not move or is cut off.
Guesses which columns are what and writes that as mapping.toml, for you to edit; one that is there is used and kept.

  trueup inspect logs/*.csv
  trueup inspect recordings/* --model robot.xml      also proposes which joint of the file is which of the model
"""

_CALIBRATE = """\
Finds the parameters of a robot model (MJCF or URDF) with which it replays the recordings, says how sure each one is,
and judges the result on recordings that were held out. In DIR you find the calibrated model, parameters.toml,
report.html (start there), replay.svg and calibration.json. Ctrl-C is fine: the same command goes on from there.

  trueup calibrate robot.xml logs/*.csv --hold-out fast --out fit
  trueup calibrate robot.xml logs/*.csv --hold-out 'walk_*' --parameters mine.toml --out fit

A parameters file says what to calibrate, one table for each line; the result, fit/parameters.toml, is such a file too:

  [[parameter]]
  quantity = "friction"       # kp, kv, damping, armature, delay, backlash, mass, ...; a wrong name lists all
  of = "*"                    # names or patterns of joints, actuators or bodies
  tie = "each"                # or "all" (one value for all), or "mirror" (left and right share one)
  nominal = 0.1               # where to start; also lower, upper, scale = "log", frozen = true
"""

_DEMO = """\
Records a simulated arm whose truth has another structure than its model (Stribeck friction, backlash, delay, encoder
grid), calibrates the model from these files alone, and writes recordings and report. Takes about a minute.

  trueup demo --out out/demo
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line and returns the exit code: 0 done, 1 an error to mend, 2 wrong usage, 130 interrupted."""
    given = list(sys.argv[1:] if argv is None else argv)
    try:
        args = _parser().parse_args(given)
    except SystemExit as done:  # argparse has said why
        return done.code if isinstance(done.code, int) else _USAGE
    args.command_line = given
    try:
        return _run(args)
    except KeyboardInterrupt:
        return _INTERRUPTED
    except BrokenPipeError:  # the reader of our output has gone, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _OK
    except Exception as error:
        message = _message(error)
        if message is None or args.debug:
            raise
        _consoles(args)[1].print(f"[bold red]error[/] {message}", soft_wrap=True, highlight=False)
        return _ERROR


def _run(args: argparse.Namespace) -> int:
    console, told = _consoles(args)
    if args.command == "inspect":
        from trueup.commands import inspect

        return inspect.run(args, console)
    if args.command == "calibrate":
        from trueup.commands import calibrate

        return calibrate.run(args, console, told)
    from trueup.commands import demo

    return demo.run(args, console, told)


def _message(error: Exception) -> str | None:
    """What to tell a user of an error; None for a mistake of trueup itself, whose traceback is wanted."""
    from rich.markup import escape

    from trueup.errors import TrueupError

    if isinstance(error, TrueupError):
        return escape(str(error))
    if isinstance(error, MemoryError):
        return "not enough memory: give fewer or shorter recordings, or fewer parameters"
    if isinstance(error, OSError):
        where = f" ({error.filename})" if error.filename else ""
        return escape(f"{error.strerror or error}{where}")
    return None


def _consoles(args: argparse.Namespace) -> tuple[Console, Console]:
    """Results go to standard output, progress, notes and errors to standard error."""
    from rich.console import Console

    return Console(), Console(stderr=True)


def _parser() -> argparse.ArgumentParser:
    shape = argparse.RawDescriptionHelpFormatter
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--debug", action="store_true", help="show the traceback of an error")
    parser = argparse.ArgumentParser("trueup", description=_ABOUT, formatter_class=shape)
    parser.add_argument("--version", action="version", version=f"trueup {_version()}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_inspect(commands.add_parser(
        "inspect", parents=[common], help="look at recordings, write a mapping", description=_INSPECT,
        formatter_class=shape,
    ))  # fmt: skip
    _add_calibrate(commands.add_parser(
        "calibrate", parents=[common], help="make a model replay recordings", description=_CALIBRATE,
        formatter_class=shape,
    ))  # fmt: skip
    demo = commands.add_parser(
        "demo", parents=[common], help="the whole, on a simulated arm", description=_DEMO, formatter_class=shape
    )
    demo.add_argument("--out", default="trueup-demo", metavar="DIR", help="where to write (default: %(default)s)")
    return parser


def _add_inspect(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", nargs="+", metavar="FILE", help="CSV, JSON, NPZ, Parquet, ROS bags, or folders")
    parser.add_argument("--mapping", metavar="FILE", help="read with this mapping instead of guessing")
    parser.add_argument("--model", metavar="MODEL", help="compare joint names with this MJCF or URDF, propose renaming")
    parser.add_argument("--write-mapping", metavar="FILE", help="where to write the mapping (default: mapping.toml)",
                        nargs="?", const="mapping.toml")  # fmt: skip
    parser.add_argument("--force", action="store_true", help="guess anew and overwrite the mapping")
    parser.add_argument("--json", action="store_true", help="print the findings as JSON, for scripts")


def _add_calibrate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", metavar="MODEL", help="MJCF or URDF of the robot")
    parser.add_argument("recordings", nargs="+", metavar="RECORDING", help="files or folders")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder for the results; the next run takes DIR-2")
    parser.add_argument("--hold-out", nargs="+", action="append", default=[], metavar="NAME",
                        help="recordings to judge by and not to fit: names, patterns ('fast_*') or paths")  # fmt: skip
    parser.add_argument("--parameters", metavar="FILE", help="what to calibrate (TOML); proposed if absent")
    parser.add_argument("--mapping", metavar="FILE", help="how columns become channels (default: mapping.toml if here)")
    parser.add_argument("--search", default="auto", choices=("auto", "gradient", "cma-es", "hybrid"),
                        help="gradient where it is smooth, cma-es where it is not (default: %(default)s)")  # fmt: skip
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of all random numbers (default: %(default)s)")
    parser.add_argument("--channels", metavar="LIST",
                        help="measured channels to fit, with commas (default: positions and sensors; velocity and torque "
                             "only if asked for, or if there is nothing else)")  # fmt: skip
    parser.add_argument("--no-select", dest="select", action="store_false",
                        help="keep parameters that the recordings cannot support")  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print the outcome as JSON, for scripts")
    parser.add_argument("--force", action="store_true", help="start anew in DIR and replace what is there")
    parser.add_argument("-q", "--quiet", action="store_true", help="no progress, no notes")


def _version() -> str:
    try:
        return importlib.metadata.version("trueup")
    except importlib.metadata.PackageNotFoundError:
        return "(not installed)"


if __name__ == "__main__":
    sys.exit(main())
