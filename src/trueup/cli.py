# SPDX-License-Identifier: Apache-2.0
"""The command `trueup`: reads the command line, runs a command of trueup.commands, prints errors as one message."""

from __future__ import annotations

import argparse
import difflib
import importlib
import importlib.metadata
import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NoReturn, cast

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
    "doctor": "whether all is in place: packages, threads, speed, pictures",
    "completion": "what completes commands and options in a shell",
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
        print("stopped; nothing had begun", file=sys.stderr)
        return _INTERRUPTED
    args.command_line = given
    if args.command == "completion":
        args.words = {name: options_of(name) for name in ("", *_COMMANDS)}
    try:
        with _ended_as_by_a_key():
            return _run(args)
    except KeyboardInterrupt as stopped:
        if not stopped.args:  # a command says why and how to go on, where there is more to say
            print("stopped", file=sys.stderr)
        return _INTERRUPTED
    except BrokenPipeError:  # the reader of our output has gone, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _OK
    except Exception as error:
        message = _message(error)
        if message is None or args.debug:
            raise
        _consoles()[1].print(f"[bold red]error[/] {message}", soft_wrap=True, highlight=False)
        return _ERROR


@contextmanager
def _ended_as_by_a_key() -> Iterator[None]:
    """SIGTERM, as a supervisor or a shutdown sends it, ends a command as Ctrl-C does: what is kept is said, and no file
    is left half written.
    """

    def interrupted(*_: object) -> NoReturn:
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():  # which alone may ask for signals
        yield
        return
    before = signal.signal(signal.SIGTERM, interrupted)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before or signal.SIG_DFL)


def _run(args: argparse.Namespace) -> int:
    console, told = _consoles()
    with warnings.catch_warnings():
        if not args.debug:
            warnings.showwarning = _notes_on(told, quiet=getattr(args, "quiet", False))
        return _module(args.command).run(args, console, told)


def _notes_on(told: Console, *, quiet: bool) -> Callable[..., None]:
    """What libraries warn of, as MuJoCo does of a file's old attributes: one note each, not lines of their code.

    What numpy says of its own arithmetic tells a user nothing; --debug shows it.
    """
    from trueup.commands.console import notes

    said: set[str] = set()

    def note(message: Warning | str, *_where: object) -> None:
        if isinstance(message, RuntimeWarning):
            return
        notes(told, {str(message)} - said, quiet=quiet)
        said.add(str(message))

    return note


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


def _consoles() -> tuple[Console, Console]:
    """Results go to standard output, progress, notes and errors to standard error."""
    from trueup.commands.console import PlainConsole

    return PlainConsole(), PlainConsole(stderr=True)


class _Parser(argparse.ArgumentParser):
    """A parser that says what was probably meant by a command, option or choice that is none."""

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        """See ArgumentParser: unknown options with their nearest neighbours."""
        found, unknown = self.parse_known_args(args, namespace)
        if unknown:
            own = self._command(getattr(found, "command", "")) or self
            # What stands behind an option that is none is its value.
            options = [word for word in unknown if word.startswith("-")]
            own.error("; ".join(_meant(word, own) for word in options or unknown))
        return found

    def error(self, message: str) -> NoReturn:
        """See ArgumentParser: an invalid choice with the nearest one, what is missing with what belongs in which place."""
        wrong = re.search(r"invalid choice: '([^']*)' \(choose from (.*)\)", message)
        if wrong:
            near = difflib.get_close_matches(wrong[1], re.findall(r"[\w.-]+", wrong[2]), n=1)
            message += f"; did you mean '{near[0]}'?" if near else ""
        places = [f"{a.metavar} ({a.help})" for a in self._actions if not a.option_strings and a.metavar and a.help]
        if "arguments are required" in message and places:
            message += f"; it takes, in this order, {', then '.join(places)}"
        super().error(message)

    def _command(self, name: str) -> _Parser | None:
        groups = [a for a in self._actions if isinstance(a, argparse._SubParsersAction)]
        return groups[0].choices.get(name) if groups else None


def _meant(word: str, parser: argparse.ArgumentParser) -> str:
    """That a word is no option, and which one is near; or that it stands apart from others of its kind."""
    several = [a.metavar for a in parser._actions if not a.option_strings and a.nargs in ("+", "*")]
    if several and not word.startswith("-"):
        return (
            f"'{word}' stands behind an option, apart: put all {several[0]} arguments side by side, before the options"
        )
    options = [o for action in parser._actions for o in action.option_strings]
    near = difflib.get_close_matches(word.partition("=")[0], options, n=1)
    return f"unrecognized argument: {word}" + (f" (did you mean '{near[0]}'?)" if near else "")


def options_of(command: str) -> list[tuple[str, str]]:
    """(option, help) of a command, or (command, help) of all for ''; for what completes them in a shell."""
    if not command:
        return list(_COMMANDS.items())
    own = cast(_Parser, _parser([command])._command(command))
    return [(o, " ".join((a.help or "").split())) for a in own._actions for o in a.option_strings if o.startswith("--")]


def _parser(given: Sequence[str]) -> _Parser:
    """The command line's parser; of the commands only the one that is `given` is loaded, so that the answer is quick."""
    from trueup.extensions import version

    shape = argparse.RawDescriptionHelpFormatter
    common = _Parser(add_help=False)
    common.add_argument("--debug", action="store_true", help="show the traceback of an error")
    parser = _Parser("trueup", description=_ABOUT, formatter_class=shape)
    parser.add_argument("--version", action="version", version=f"trueup {version()}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=_Parser)
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


if __name__ == "__main__":
    sys.exit(main())
