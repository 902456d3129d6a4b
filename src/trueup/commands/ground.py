# SPDX-License-Identifier: Apache-2.0
"""`trueup ground`: what a robot's joints do with commands is learned from recordings, and told to a simulator."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from trueup.campaign.output import free_folder
from trueup.commands.console import notes, table_of, tell
from trueup.commands.progress import bar
from trueup.commands.sources import add_shared, given, typed
from trueup.errors import GroundingError, counted
from trueup.formats.plain import finite, write_json
from trueup.recording import Recording
from trueup.report.grounding import write_grounding_report
from trueup.report.numbers import scale_for
from trueup.trial import Trial

if TYPE_CHECKING:
    from trueup.engines.simulator import Simulator
    from trueup.grounding.comparison import Score
    from trueup.grounding.grounded import GroundedSimulator
    from trueup.grounding.grounding import Grounding
    from trueup.grounding.learn import Learned, Wishes
    from trueup.loop.prepare import Preparation

ABOUT = """\
Learns from recordings what a robot's joints do with a command: their positions one frame later, from joints, commands and
whatever else was measured. Ten learners are compared on whole runs that were left out (honest), and on rows that were left
out (as papers do); the one that wins stays if it beats a line beyond doubt. With --model, a simulator is grounded by it: its
commands pass through what was learned, as much of it as makes it replay the robot best. In DIR you find

  grounding.npz     what was learned: trueup replay MODEL LOGS --grounding DIR/grounding.npz, trueup.grounding in Python
  report.html       start there
  grounding.json    all numbers

  trueup ground logs/*.csv --out ground
  trueup ground logs/*.csv --hold-out 'walk_*' --model robot.xml --out ground
  trueup ground logs/*.csv --learners linear model-tree --history 3 --out ground

A run that asks for what was not learned is refused in the simulator: it fails, and says which command was too far off.
"""

_TOLD = {
    "": "what is predicted",
    "command": "what it lacks, added to its commands",
    "torque": "what it lacks, as torque",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What this command takes."""
    add_shared(parser, "recordings", "out", "hold-out", "mapping", "seed", "json", "quiet")
    parser.add_argument("--model", metavar="MODEL", help="MJCF or URDF of a simulator to ground")
    parser.add_argument("--learners", nargs="+", metavar="NAME", help="which to compare (default: all ten; a wrong name "
                        "lists them)")  # fmt: skip
    parser.add_argument("--period", type=float, metavar="S",
                        help="frame in s (default: that of the recordings, at least 0.02)")  # fmt: skip
    parser.add_argument("--history", type=int, metavar="N", help="frames that go in (default: as many as pay)")
    parser.add_argument("--view", metavar="NAME", help="what a prediction looks at: plain (all as it is, the paper's), "
                        "relative (to where joints stand), own (the joint alone), posed (that, and all positions); "
                        "default: what predicts runs left out best")  # fmt: skip
    parser.add_argument("--others", nargs="*", metavar="CHANNEL", help="other channels that go in, such as com (default: "
                        "those that pay)")  # fmt: skip
    parser.add_argument("--joints", nargs="+", metavar="NAME", help="joints to learn (default: all commanded ones)")
    parser.add_argument("--share", type=float, metavar="X", help="how much of what is predicted is told to a simulator, 0 to "
                        "1 (default: found with --model, else 0.3 as in the paper)")  # fmt: skip
    parser.add_argument("--no-inverse", dest="inverse", action="store_false",
                        help="without the simulator's inverse model, as the paper did")  # fmt: skip
    parser.add_argument("--residual", choices=("command", "torque"),
                        help="with --model: in place of both, what that simulator lacks is found by search in it, so that it "
                        "replays the robot: added to commands (a delta action), or to joints as torque")  # fmt: skip
    parser.add_argument("--budget", type=float, default=120.0, metavar="S",
                        help="CPU time for comparing learners (default: %(default)g s)")  # fmt: skip


def run(args: argparse.Namespace, console: Console, told: Console) -> int:
    """Learns, judges, writes. Raises TrueupError. Returns the exit code."""
    if args.share is not None and not 0.0 <= args.share <= 1.0:
        raise GroundingError(f"--share {args.share:g}: what is predicted may have a share of 0 to 1")
    if not 0.0 < args.budget < math.inf:
        raise GroundingError(f"--budget {args.budget:g}: a number above 0 is needed")
    if args.residual and not args.model:
        raise GroundingError(
            f"--residual {args.residual}: what a simulator lacks is found in it; say which with --model"
        )
    from trueup.grounding.remarks import remark_of_share

    training, held_out, found = given(args)
    if not training:
        raise GroundingError(f"all {len(held_out)} recordings are held out; none is left to learn from")
    notes(told, found, quiet=args.quiet)
    ready = _prepared(args, training, held_out, told)
    if ready is not None:
        training, held_out = list(ready.recordings), list(ready.hold_out)
    learned, scores = _learned(args, training, held_out, told)
    notes(told, learned.notes, quiet=args.quiet)
    story = _story(args, learned, scores, training, held_out)
    grounding = (
        learned.grounding.weighted(1.0 - args.share, args.share) if args.share is not None else learned.grounding
    )
    if ready is not None:
        grounding, story["simulator"] = _grounded(args, grounding, ready)
        said = remark_of_share(grounding, ready.recordings) if args.share is None else ()
        story["notes"] += said
        notes(told, said, quiet=args.quiet)
    folder = free_folder(Path(args.out))
    grounding.save(folder / "grounding.npz")
    write_grounding_report(story, folder / "report.html")
    write_json(story, folder / "grounding.json")
    if args.json:
        console.print_json(data=finite(story))
    else:
        _show(story, console)
        tell(console, f"  start with {escape(str(folder / 'report.html'))}")
    return 0


def _prepared(
    args: argparse.Namespace, training: Sequence[Recording], held_out: Sequence[Recording], told: Console
) -> Preparation | None:
    """The simulator to ground, and recordings with its names, of channels that it shows; None where no model was named."""
    from trueup.grounding.others import as_shown
    from trueup.loop.prepare import prepare

    if not args.model:
        return None
    ready = prepare(args.model, training, held_out, propose=False)
    shown, said = as_shown(ready.recordings, ready.simulator)
    kept, _ = as_shown(ready.hold_out, ready.simulator)
    notes(told, [*ready.notes, *said], quiet=args.quiet)
    return replace(ready, recordings=tuple(shown), hold_out=tuple(kept))


def _learned(
    args: argparse.Namespace, training: Sequence[Recording], held_out: Sequence[Recording], told: Console
) -> tuple[Learned, dict[str, Score]]:
    """What was learned, and how it does on what was held out; with progress."""
    from trueup.grounding.learn import judged, learn

    with bar(told, quiet=args.quiet) as shown:
        task = shown.add_task("reading", total=1.0, said="")
        learned = learn(
            training,
            _wishes(args),
            held_out=held_out,
            progress=lambda words, done: shown.update(task, description=words, completed=done),
        )
    return learned, judged(learned, held_out) if held_out else {}


def _wishes(args: argparse.Namespace) -> Wishes:
    from trueup.grounding.learn import Wishes

    learners, others, joints = (
        None if named is None else tuple(named) for named in (args.learners, args.others, args.joints)
    )
    return Wishes(args.period, args.history, args.view, others, joints, learners, args.budget, seed=args.seed)


def _story(
    args: argparse.Namespace, learned: Learned, scores: dict[str, Score], training: Sequence[Recording],
    held_out: Sequence[Recording],
) -> dict[str, Any]:  # fmt: skip
    """All numbers, plain."""
    from trueup.grounding.learners import LEARNERS

    inputs, found = learned.grounding.inputs, learned.comparison
    rows = [
        {"learner": name, "weka": LEARNERS[name].weka, "by_run": _plain(found.by_run[name]),
         "by_row": _plain(found.by_row[name]) if name in found.by_row else None}
        for name in found.by_run
    ]  # fmt: skip
    return {
        "command": typed(args),
        "recordings": [r.name for r in training], "held_out": [r.name for r in held_out],
        "frames": len(learned.rows.X), "period": inputs.period, "history": inputs.history, "view": learned.view,
        "joints": list(inputs.commands), "unit": inputs.unit, "others": {n: list(x) for n, x in inputs.others.items()},
        "tried": [{"inputs": words, "error": error} for words, error in learned.tried],
        "learners": rows, "hold": _plain(found.held),
        "chosen": learned.grounding.about["learner"], "why": learned.grounding.about["why"],
        "skipped": list(found.skipped), "judged": [_plain(s) for s in scores.values()],
        "domain": [{"block": b.name, "limit": b.limit, "frames": b.patience} for b in learned.grounding.domain.blocks],
        "seconds": learned.seconds, "notes": list(learned.notes), "shown": learned.shown.plain(),
    }  # fmt: skip


def _plain(score: Score) -> dict[str, Any]:
    return {"name": score.name, "rae": score.rae.tolist(), "rrse": score.rrse.tolist(), "rmse": score.rmse.tolist(),
            "error": score.error, "ahead": score.typical, "seconds": score.seconds}  # fmt: skip


def _grounded(args: argparse.Namespace, grounding: Grounding, ready: Preparation) -> tuple[Grounding, dict[str, Any]]:
    """A simulator's replay grounded and not, with the share and the inverse model that serve it best."""
    from trueup.grounding.blend import best_way
    from trueup.grounding.grounded import GroundedSimulator

    simulator, values = ready.simulator, ready.simulator.parameters.nominal
    best, why = best_way(
        grounding, simulator, ready.recordings, values, inverse=args.inverse, residual=args.residual or "",
        share=args.share, seed=args.seed,
    )  # fmt: skip
    told_of: dict[str, Any] = {
        "share": best.weights[1], "inverse": best.inverse is not None, "residual": args.residual or "", "why": why,
        "model": simulator.name, "chained": best.chained, "refused": {},
    }  # fmt: skip
    each: list[dict[str, Any]] = []
    grounded = GroundedSimulator(simulator, best)
    for kind, recordings in (("learned from", ready.recordings), ("held out", ready.hold_out)):
        if recordings:
            each += _replays(kind, recordings, simulator, grounded, values)
            told_of["refused"] |= _refused(grounded, recordings, values)
    return best, {**told_of, "replays": each}


def _replays(
    kind: str, recordings: Sequence[Recording], simulator: Simulator, grounded: GroundedSimulator,
    values: np.ndarray[Any, Any],
) -> list[dict[str, Any]]:  # fmt: skip
    """Errors of all that is compared, recording by recording, the joints' first."""
    from trueup.grounding.blend import compared

    before, after = (compared(s, recordings, values[None]) for s in (simulator, grounded))
    return [
        {"recording": r.name, "kind": kind, "channel": name, "unit": r.channel(name).unit,
         "before": float(before.of(name)[0, k]), "after": float(after.of(name)[0, k])}
        for k, r in enumerate(recordings) for name in before.channels if r.has(name)
    ]  # fmt: skip


def _refused(
    simulator: GroundedSimulator, recordings: Sequence[Recording], values: np.ndarray[Any, Any]
) -> dict[str, str]:
    """Recordings whose replay failed, and why."""
    done = simulator.rollout([Trial.of(r, ["position"]) for r in recordings], values[None])
    return {r.name: o.failures[0] for r, o in zip(recordings, done, strict=True) if 0 in o.failures}


def _show(story: dict[str, Any], console: Console) -> None:
    mean = {k: float(np.nanmean(story["hold"][k])) for k in ("rae", "rrse")}
    table = Table(box=SIMPLE, title=f"the next {1e3 * story['period']:.0f} ms of {len(story['joints'])} joints, predicted",
                  title_justify="left", caption_justify="left")  # fmt: skip
    table.caption = (
        "rows, runs: left out at random, or whole. Errors in % of the mean's, averaged over joints that "
        "move;\n1 s on: going on from own predictions, in spreads of the joints"
    )
    for name in ("", "rows: RAE", "RRSE", "runs: RAE", "RRSE", "1 s on", "fit s"):
        table.add_column(name, justify="right" if name else "left", no_wrap=True)
    for row in story["learners"]:
        cells = []
        for kind in ("by_row", "by_run"):
            cells += (
                ["", ""] if row[kind] is None else [f"{100 * np.nanmean(row[kind][k]):.2f}" for k in ("rae", "rrse")]
            )
        run, chosen = row["by_run"], row["learner"] == story["chosen"]
        name = f"[bold green]{row['learner']}[/]" if chosen else row["learner"]
        table.add_row(name, *cells, f"{run['ahead']:.3g}", f"{run['seconds']:.2f}")
    table.add_row("hold the last value", "", "", f"{100 * mean['rae']:.2f}", f"{100 * mean['rrse']:.2f}",
                  f"{story['hold']['ahead']:.3g}", "")  # fmt: skip
    console.print(table)
    more = f", with {', '.join(story['others'])}" if story["others"] else ""
    looks = f"{story['view']} view, {counted(story['history'], 'frame')}{more}"
    tell(console, f"  {story['chosen']}, {looks}: {story['why']}")
    if story["skipped"]:
        console.print(f"  left out, --budget was not enough: {', '.join(story['skipped'])}", soft_wrap=True)
    for s in story["judged"]:
        scale = scale_for(story["unit"], [s["error"]])
        words = f"{scale.text(s['error'])} {scale.unit}, a second on {s['ahead']:.3g} spreads"
        tell(console, f"  held out: {s['name']:20} {words}")
    if "simulator" in story:
        _show_replays(story["simulator"], console)


def _show_replays(told: dict[str, Any], console: Console) -> None:
    table = table_of("", "", "", "as it is", "grounded", "", title=f"{told['model']}: replay error")
    for r in told["replays"]:
        scale = scale_for(r["unit"], [x["before"] for x in told["replays"] if x["channel"] == r["channel"]])
        after = scale.text(r["after"]) if np.isfinite(r["after"]) else "refused"
        shown = (escape(r["recording"]), r["kind"], r["channel"], scale.text(r["before"]), after, scale.unit)
        table.add_row(*shown)
    console.print(table)
    how = f"{', chained' * told['chained']}{', by the inverse model of the simulator' * told['inverse']}"
    what = f"{told['share']:.2g} of {_TOLD[told['residual']]}{how}"
    tell(console, f"  {what}: {told['why']}")
    for name, reason in told["refused"].items():
        tell(console, f"  [yellow]{escape(name)}[/] {escape(reason)}")
