# SPDX-License-Identifier: Apache-2.0
"""The command `trueup`: reads the command line, runs a command of trueup.commands, prints errors as one message."""

from __future__ import annotations

import argparse
import importlib
import importlib.metadata
import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

_OK, _ERROR, _USAGE, _INTERRUPTED = 0, 1, 2, 130

_ABOUT = """\
Makes a robot's simulator agree with the robot, from a handful of recordings.

  trueup inspect logs/*.csv --model robot.xml        what is in the logs; writes mapping.toml
  trueup calibrate robot.xml logs/*.csv --hold-out fast --out fit
  trueup identify arm.urdf logs/*.csv --hold-out 30% --out model   an arm's dynamic model, which predicts torque
  trueup identify-actuator logs/*.json --mass 0.5 --length 0.1 --out servo   one servo that moves a known load
  trueup ground logs/*.csv --model robot.xml --out ground    what the joints do with commands, learned; told to a simulator
  trueup new NAME && cd NAME && trueup run            a campaign: experiment, calibrate, optimize, transfer, in rounds
  trueup demo                                        the whole, on a simulated robot, nothing needed
"""


_COMMANDS = {
    "inspect": "look at recordings, write a mapping",
    "calibrate": "make a model replay recordings",
    "replay": "how well a model replays recordings as it is, or two models side by side",
    "ground": "learn what joints do with commands, and tell it to a simulator",
    "excite": "a motion that identifies an arm, and that it can perform",
    "identify": "a dynamic model of an arm that predicts torque",
    "identify-actuator": "a servo's law from recordings of it with a known load",
    "demo": "the whole, on a simulated robot",
    "new": "write a campaign's plan, to edit",
    "run": "run a campaign: experiment, calibrate, optimize, transfer",
    "status": "how a campaign stands",
    "resume": "go on with a campaign",
    "report": "a campaign's story, as one HTML file",
}
"""Command -> its line in the help; trueup.commands.COMMAND holds ABOUT, add_arguments(parser) and run(...)."""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line and returns the exit code: 0 done, 1 an error to mend, 2 wrong usage, 130 interrupted."""
    given = list(sys.argv[1:] if argv is None else argv)
    # Matrices are small here: several threads for one only wait for each other, and make others wait.
    if "OMP_NUM_THREADS" not in os.environ:
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        args = _parser(given).parse_args(given)
    except SystemExit as done:  # argparse has said why
        return done.code if isinstance(done.code, int) else _USAGE
    except KeyboardInterrupt:  # while the command is being loaded
        return _INTERRUPTED
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
    return _module(args.command).run(args, console, told)


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
    from trueup.commands.console import PlainConsole

    return PlainConsole(), PlainConsole(stderr=True)


def _parser(given: Sequence[str]) -> argparse.ArgumentParser:
    """The command line's parser; of the commands only the one that is `given` is loaded, so that the answer is quick."""
    shape = argparse.RawDescriptionHelpFormatter
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--debug", action="store_true", help="show the traceback of an error")
    parser = argparse.ArgumentParser("trueup", description=_ABOUT, formatter_class=shape)
    parser.add_argument("--version", action="version", version=f"trueup {_version()}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, line in _COMMANDS.items():
        module = _module(name) if name in given else None
        command = commands.add_parser(
            name, parents=[common], help=line, description=module.ABOUT if module else line, formatter_class=shape
        )
        if module:
            module.add_arguments(command)
    return parser


def _module(command: str) -> Any:
    return importlib.import_module(f"trueup.commands.{command.replace('-', '_')}")


def _version() -> str:
    try:
        return importlib.metadata.version("trueup")
    except importlib.metadata.PackageNotFoundError:
        return "(not installed)"


if __name__ == "__main__":
    sys.exit(main())
