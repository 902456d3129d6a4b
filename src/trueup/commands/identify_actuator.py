# SPDX-License-Identifier: Apache-2.0
"""`trueup identify-actuator`: recordings of one servo that moves a known load in, its law out, for any simulator."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from trueup.calibration import Replay
from trueup.campaign.output import free_folder
from trueup.commands.console import notes, table_of, tell
from trueup.commands.sources import add_shared, given, step_of
from trueup.formats.aside import write_aside
from trueup.report.numbers import duration_text
from trueup.report.picture import replay_picture
from trueup.trial import STEP

if TYPE_CHECKING:
    from trueup.actuators.experiment import Value
    from trueup.actuators.identify import Actuator

ABOUT = """\
Finds the law of one servo from recordings in which it moves a load that is known: firmware gain, full duty, DC motor,
friction, and what else left-out recordings want (delay, punch, dead band, PD, PI, profile ...). Log commands and positions,
at 100 Hz or more, of slow and fast motion, with loads up to what it can lift; a stretch with torque off, swinging free, tells
friction from back-EMF. Several settings of the gain may be mixed if the logs name them (kp).

  trueup identify-actuator logs/*.json --mass 0.49 --length 0.1 --out servo     a pendulum: kg, m from the axis
  trueup identify-actuator logs/*.csv --bench bench.toml --hold-out fast --out servo
  trueup identify-actuator foot.csv                                        load unknown: ratios of the gains only

In DIR you find actuator.py (the law; needs nothing but Python; its first lines say how to use it in plain MuJoCo),
actuator.xml (the nearest that MJCF can hold, with its load), actuator.json (all figures) and pictures of replays.
A bench file, in SI units:

  mass = 0.49        # kg
  length = 0.1       # m, from the axis to the centre of mass
  arm_mass = 0.0     # kg, of a uniform rod between axis and mass, on top of it
  inertia = 2e-4     # kg m2, about the centre of mass; about the axis where no mass is given
  hangs_at = 0.0     # rad, where the load hangs straight down
  gravity = 9.81     # m/s2; 0 where the axis is vertical
"""
PYTHON, MJCF, FIGURES = _FILES = ("actuator.py", "actuator.xml", "actuator.json")
_LOADS = {
    "mass": "kg that the servo carries",
    "length": "m from the axis to the load's centre of mass",
    "arm-mass": "kg of a uniform rod between axis and load, on top of it (default 0)",
    "inertia": "kg m2 about the load's centre of mass; about the axis where no mass is given",
    "hangs-at": "rad, position at which the load hangs straight down (default 0)",
    "gravity": "m/s2 across the axis (default 9.81); 0 for a vertical axis",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What this command takes."""
    parser.add_argument("recordings", nargs="+", metavar="RECORDING", help="logs of commands and positions, or folders")
    parser.add_argument("--bench", metavar="FILE", help="what the servo carries, as TOML (see above)")
    for name, line in _LOADS.items():
        parser.add_argument(f"--{name}", type=float, metavar="X", help=line)
    parser.add_argument("--joint", default="", metavar="NAME", help="which joint, where the recordings have several")
    add_shared(parser, "hold-out", "mapping", "quiet")
    parser.add_argument("--ask", nargs="*", metavar="STRUCTURE",
                        help='ask about these structures only, by their names in the table ("dead band")')  # fmt: skip
    parser.add_argument(
        "--step", type=step_of, default=STEP, metavar="S", help=f"integration step in s (default {STEP})"
    )
    parser.add_argument("--out", metavar="DIR", help="where to write actuator.py, actuator.xml and actuator.json")
    parser.add_argument(
        "--force", action="store_true", help="overwrite them in DIR; otherwise DIR-2, DIR-3 ... are used"
    )


def run(args: argparse.Namespace, console: Console, told: Console) -> int:
    """Identifies, shows and writes. Returns the exit code."""
    from trueup.actuators.bench import Bench
    from trueup.actuators.identify import identify_actuator

    bench = Bench.read(Path(args.bench)) if args.bench else Bench()
    loads = {n.replace("-", "_"): getattr(args, n.replace("-", "_")) for n in _LOADS}
    bench = replace(bench, **{n: v for n, v in loads.items() if v is not None})
    folder = Path(args.out) if args.out else None
    if folder is not None and not args.force:
        folder = free_folder(folder, lambda at: not any((at / name).exists() for name in _FILES))
    fitted, kept, found = given(args, driven=False)
    with _progress(told, quiet=args.quiet) as watch:
        actuator = identify_actuator(
            fitted, kept, bench=bench, joint=args.joint, step=args.step, ask=args.ask, told=watch
        )
    notes(console, (*found, *actuator.notes), quiet=args.quiet)
    _show(actuator, console)
    if folder is not None:
        _written(actuator, [*actuator.write(folder), *_pictures(actuator, folder)], console)
    return 0


@contextmanager
def _progress(told: Console, *, quiet: bool) -> Any:
    """A line that says what is asked and how good replays of left-out recordings are by now."""
    if quiet:
        yield lambda *_: None
        return
    with told.status("replaying ...") as status:
        yield lambda what, error: status.update(
            f"asking about: {what}" + (f"; left-out error {1e3 * error:.3g} mrad" if math.isfinite(error) else "")
        )


def _show(actuator: Actuator, console: Console) -> None:
    seen = actuator.experiment
    if seen.ratios:
        console.print(
            _numbers("by regression (error = load / kp + kd / kp speed + kc / kp sign)", [*seen.ratios, *seen.gains])
        )
        tell(console, f"explains {100 * seen.explained:.0f} % of the error while it moves")
    for sentence in seen.cannot:
        tell(console, f"[cyan]cannot tell[/] {escape(sentence)}")
    if actuator.law is None:
        return
    console.print(_structures(actuator))
    console.print(_numbers("by simulation", actuator.values))
    for value in actuator.values:
        if value.high > 3.0 * max(value.low, 0.0) and value.value > 0.0:
            tell(console, f"[cyan]cannot tell[/] {value.name} to better than {value.low:.3g} ... {value.high:.3g} "
                          f"{value.unit}: the recordings see it in combination with others only")  # fmt: skip
    console.print(_errors(actuator))
    tell(console, f"took {duration_text(actuator.seconds)}")


def _numbers(title: str, values: Sequence[Value]) -> Table:
    table = table_of("", "value", "95 % interval", "", title=title)
    for v in values:
        table.add_row(v.name, f"{v.value:.4g}", f"{v.low:.3g} ... {v.high:.3g}", v.unit)
    return table


def _structures(actuator: Actuator) -> Table:
    table = table_of(
        "structure", "left-out error without", "with, mrad", "with it", "", words=("structure", "with it", ""),
        title="what it is made of: kept where left-out recordings want it by two standard errors, or by one where none is "
        "replayed worse",
    )  # fmt: skip
    for a in actuator.asked:
        kept = "[bold]kept[/]" if a.name in actuator.structures else "left out"
        table.add_row(a.name, f"{1e3 * a.without:.1f}", f"{1e3 * a.with_it:.1f}",
                      a.evidence.in_words(), kept)  # fmt: skip
    return table


def _errors(actuator: Actuator) -> Table:
    table = table_of("recording", "actuator.py", "actuator.xml, mrad", "", words=("recording", ""),
                     title="mean absolute error of whole replays by fits that never saw them")  # fmt: skip
    for j in actuator.judged:
        table.add_row(escape(j.name), f"{1e3 * j.model:.1f}", f"{1e3 * j.file:.1f}", "held out" if j.held_out else "")
    for held, word in ((False, "mean, left out in turn"), (True, "mean, held out")):
        if math.isfinite(actuator.error(held_out=held)):
            both = (f"{1e3 * actuator.error(held_out=held, file=f):.1f}" for f in (False, True))
            table.add_row(f"[bold]{word}[/]", *both, "")
    return table


def _written(actuator: Actuator, paths: Sequence[Path], console: Console) -> None:
    """Names the files; the MJCF is read back and replayed by the engine itself, on the load that it holds."""
    from trueup.actuators.actuator import replay_file

    tell(console, f"wrote {', '.join(escape(str(p)) for p in paths)}")
    for path in paths:
        runs = [r for r in actuator.runs if r.bench == actuator.bench] if path.name == MJCF else []
        if runs:
            errors = [abs(replay_file(path, r) - r.position).mean() for r in runs]
            tell(console, f"{path.name} read back replays {len(runs)} recordings (fitted ones among them) to "
                          f"{1e3 * sum(errors) / len(errors):.1f} mrad")  # fmt: skip


def _pictures(actuator: Actuator, folder: Path) -> list[Path]:
    """A picture of each recording that was held out, of each fitted one if none was: as measured, by the law, by the MJCF."""
    from trueup.actuators.replay import replay

    if actuator.law is None or actuator.file_law is None:
        return []
    held = {j.name for j in actuator.judged if j.held_out}
    paths = []
    for run in (r for r in actuator.runs if not held or r.name in held):
        law = replay(actuator.law, run, actuator.step)[:, None]
        file = replay(actuator.file_law, run, actuator.step, file=True)[:, None]
        at = run.given(run.time)
        told = np.where(run.on[at], run.command[at], np.nan)[:, None]
        drawn = Replay(run.name, run.name in held, "position", ("joint",), "rad", run.time, run.position[:, None], file, law,
                       told, np.array([run.noise]))  # fmt: skip
        paths.append(folder / f"replay-{Path(run.name).name}.svg")
        write_aside(replay_picture(drawn, names={"before": MJCF, "after": PYTHON}), paths[-1])
    return paths
