# SPDX-License-Identifier: Apache-2.0
"""Runs the study: `python -m trueup.studies.walk --out out/study-walk`, minutes of a core for a robot, seed and way."""

from __future__ import annotations

import argparse
import sys
from contextlib import closing
from pathlib import Path

from rich.console import Console

from trueup.commands.where import add_cluster, evaluator_of
from trueup.errors import RenderingError, TrueupError
from trueup.formats.aside import write_aside
from trueup.studies.progress import telling
from trueup.studies.saved import Parts
from trueup.studies.walk.comparison import FULL, PAPER, QUICK, Result, Searching, performed, summary
from trueup.studies.walk.film import strip
from trueup.studies.walk.guidance import Expert
from trueup.studies.walk.methods import Ungrounded
from trueup.studies.walk.report import html
from trueup.studies.walk.robot import StandInNao
from trueup.studies.walk.ways import CHALLENGER, CONTROL, WAYS, ways


def main() -> int:
    """Writes report.html, a film strip and parts of the results into the folder given; returns the exit code."""
    asked = _asked()
    told, scale = Console(stderr=True), QUICK if asked.quick else PAPER if asked.paper else FULL
    robots, seeds = asked.robots or (1 if asked.quick else 8), asked.seeds or (1 if asked.quick else 5)
    results: list[Result] = []
    try:
        chosen = ways(list(WAYS) if asked.all else asked.ways or [CONTROL, CHALLENGER])
        if asked.expert:
            chosen[f"noisy + {asked.expert.name}"] = Searching(Ungrounded(), Expert.read(asked.expert))
        kept, whole = Parts.at(asked.out, scale), robots * seeds * len(chosen)
        where = evaluator_of(asked.cluster or "", asked.quorum or 1.0, told)
        with telling(told, "the start walk") as tell, closing(where) as evaluator:
            for r in performed(
                chosen, scale, range(robots), range(seeds), lambda text: tell(text, len(results) / whole), kept.text,
                evaluator,
            ):  # fmt: skip
                results.append(r)
        film = _film(results, scale.share, asked.out / "film.svg", told)
        write_aside(html(results, film), asked.out / "report.html")
    except (TrueupError, OSError) as error:
        told.print(str(error), style="red", markup=False)
        return 2
    except KeyboardInterrupt:
        told.print("stopped; the same command goes on with what is not there yet", markup=False)
        return 130
    for line in summary(results):
        Console().print(line, markup=False)
    Console().print(f"report: {asked.out / 'report.html'}", soft_wrap=True, markup=False)
    return 0


def _asked() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m trueup.studies.walk", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/study-walk"), help="folder of the results")
    parser.add_argument("--robots", type=int, help="how many stand-ins (default 8; 1 with --quick)")
    parser.add_argument("--seeds", type=int, help="searches on each (default 5; 1 with --quick)")
    parser.add_argument(
        "--ways", nargs="+", metavar="WAY", help=f"of: {'; '.join(WAYS)} (default: {CONTROL}, {CHALLENGER})"
    )
    parser.add_argument(
        "--expert", type=Path, help="TOML of what an expert freezes and widens: one more way, by its name"
    )
    parser.add_argument("--all", action="store_true", help="all ways")
    parser.add_argument("--quick", action="store_true", help="short searches on one stand-in: a minute, and rough")
    parser.add_argument("--paper", action="store_true", help="150 candidates a generation: hours")
    add_cluster(parser)
    return parser.parse_args()


def _film(results: list[Result], share: float, out: Path, told: Console) -> str:
    """An SVG of the start walk and of the best that was found; '' where the machine has no graphics."""
    best = max((r for r in results if r.falls <= 0.03), default=results[0], key=lambda r: r.gain)
    walks = {
        f"start walk, {100 * best.start_speed:.1f} cm/s with steps of {100 * best.start_share:.0f} %": (
            best.start(), best.start_share,
        ),
        f"{best.way}: {100 * best.speed:.1f} cm/s with steps of {100 * share:.0f} %": (best.final(), share),
    }  # fmt: skip
    try:
        return strip(StandInNao(best.truth(), log=50.0), walks, out).read_text(encoding="utf-8")
    except RenderingError as error:
        told.print(str(error), markup=False)
        return ""


if __name__ == "__main__":
    sys.exit(main())
