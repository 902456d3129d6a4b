# SPDX-License-Identifier: Apache-2.0
"""Runs every benchmark beside this file and writes the table of docs/benchmarks.md from their RESULT lines.

A benchmark is a file without a leading underscore that can be run (it has an `if __name__ == "__main__"`). It prints
one line for each figure: `RESULT {"name": ..., "value": ..., "unit": ..., "peer": ..., "peer_value": ..., "ratio": ...,
"goal": ..., "met": true}`; what does not apply is null. Arguments: names of benchmarks to run alone (their rows are
replaced, the others stay), and `--quick`, which is for a look: it writes no table.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
PAGE = FOLDER.parent / "docs" / "benchmarks.md"
BEGIN, END = "<!-- results -->", "<!-- end of results -->"
HEAD = (
    "| benchmark | figure | value | peer | its value | ratio | goal | met |",
    "| --- | --- | ---: | --- | ---: | ---: | --- | :-: |",
)


@dataclass(frozen=True)
class Outcome:
    """What one benchmark left: table rows, wall time in s, and what went wrong ('' if nothing)."""

    name: str
    rows: tuple[str, ...]
    seconds: float
    problem: str


def benchmarks(folder: Path) -> list[Path]:
    """The files that are benchmarks, by name."""
    runnable = re.compile(r"^if __name__ == ['\"]__main__['\"]", re.MULTILINE)
    files = (path for path in sorted(folder.glob("*.py")) if not path.name.startswith("_"))
    return [path for path in files if runnable.search(path.read_text(encoding="utf-8"))]


def run(path: Path, arguments: Sequence[str]) -> Outcome:
    """Runs one benchmark, its output shown as it comes; a failure is an outcome, so that the others still run."""
    print(f"\n== {path.stem}", flush=True)
    start = time.perf_counter()
    command = [sys.executable, "-u", str(path), *arguments]
    rows: list[str] = []
    problem = ""
    with subprocess.Popen(command, cwd=FOLDER.parent, stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout or ():
            print(line, end="", flush=True)
            if line.startswith("RESULT "):
                try:
                    rows.append(row(path.stem, json.loads(line.removeprefix("RESULT "))))
                except (ValueError, KeyError, TypeError) as error:
                    problem = f"a RESULT line cannot be read ({error!r}): {line.strip()}"
    if process.returncode:
        problem = f"ended with code {process.returncode}"
    elif not rows and not problem:
        problem = "printed no RESULT line"
    return Outcome(path.stem, tuple(rows), time.perf_counter() - start, problem)


def row(benchmark: str, result: dict[str, object]) -> str:
    """One line of the table from one RESULT."""
    unit = str(result.get("unit") or "")
    met = result.get("met")
    cells = (
        benchmark,
        str(result["name"]),
        number(result["value"], unit),
        str(result.get("peer") or ""),
        number(result.get("peer_value"), unit),
        number(result.get("ratio")),
        number(result.get("goal")),
        "" if met is None else "yes" if met else "**no**",
    )
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


def number(value: object, unit: str = "") -> str:
    """Three significant digits and the unit; text as it is, nothing for None."""
    if value is None:
        return ""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    return f"{value:.3g} {unit}".strip()


def table(outcomes: Iterable[Outcome], kept: Iterable[str] = ()) -> str:
    """The table with the rows of `outcomes` and those `kept` from an earlier table, by benchmark."""
    rows = [*kept]
    for outcome in outcomes:
        rows += outcome.rows
        if outcome.problem:
            rows.append(f"| {outcome.name} | {outcome.problem.replace('|', ' ')} | | | | | | **no** |")
    rows.sort(key=lambda line: line.split("|")[1].strip())  # stable: figures stay in the order of their benchmark
    return "\n".join((*HEAD, *rows))


def machine() -> str:
    """What the figures were measured on, in one line."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("mujoco", "numpy", "numba"))
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return (
        f"Measured on {platform.system()} {platform.machine()}, {processor()}, {cores} cores; "
        f"Python {platform.python_version()}, {packages}; {time.strftime('%Y-%m-%d')}."
    )


def processor() -> str:
    """The processor's model as the system names it."""
    try:
        names = re.findall(r"^model name\s*: (.+)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    except OSError:
        names = []
    return names[0] if names else platform.processor() or "unknown processor"


def kept_rows(page: str, anew: Iterable[str]) -> list[str]:
    """The rows of an earlier table whose benchmark was not run anew."""
    lines = page.partition(BEGIN)[2].partition(END)[0].splitlines()
    rows = [line for line in lines if line.startswith("| ") and line not in HEAD]
    return [line for line in rows if line.split("|")[1].strip() not in set(anew)]


def with_table(page: str, text: str) -> str:
    """The page with what stands between its marks replaced; `ValueError` if it has no marks."""
    if BEGIN not in page or END not in page:
        raise ValueError(f"{PAGE} has no '{BEGIN}' ... '{END}' for the table to go between")
    before, _, rest = page.partition(BEGIN)
    return f"{before}{BEGIN}\n{text}\n{END}{rest.partition(END)[2]}"


def main() -> int:
    """Runs what was asked for; 1 if a benchmark failed, 2 if a name is unknown. A goal that is missed is no failure."""
    known = {path.stem: path for path in benchmarks(FOLDER)}
    parser = argparse.ArgumentParser(description="Runs the benchmarks and writes docs/benchmarks.md.")
    parser.add_argument("names", nargs="*", help=f"of: {', '.join(known)} (default: all)")
    parser.add_argument("--quick", action="store_true", help="under a minute each, no table written")
    asked = parser.parse_args()
    if unknown := sorted(set(asked.names) - set(known)):
        print(f"no benchmark {', '.join(unknown)}; benchmarks are: {', '.join(known)}", file=sys.stderr)
        return 2
    names = asked.names or list(known)
    outcomes = [run(known[name], ["--quick"] if asked.quick else []) for name in names]
    page = PAGE.read_text(encoding="utf-8")
    text = table(outcomes, kept_rows(page, names) if asked.names else ())
    print(f"\n{text}\n")
    for outcome in outcomes:
        print(f"{outcome.name}: {outcome.seconds:.0f} s{f', {outcome.problem}' if outcome.problem else ''}")
    if not asked.quick:
        PAGE.write_text(with_table(page, f"\n{machine()}\n\n{text}\n"), encoding="utf-8")
        print(f"wrote {PAGE.relative_to(FOLDER.parent)}")
    return 1 if any(outcome.problem for outcome in outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())
