# SPDX-License-Identifier: Apache-2.0
"""Damaged files through the commands: no traceback, nothing slow, no journal that was altered and believed.

Each case copies a sound file (a log in any format, a mapping, parameters, a model, drives, a plan, a campaign's journal),
damages the copy (benchmarks/damage.py) and runs the commands that read it, in this process: `inspect`, `replay`, `calibrate
--dry-run`, `identify`, `run --dry-run`, `status`, `resume`. A case fails where a command raises anything, takes more than
20 s, or prints a control character; a journal fails where its bytes differ and a command that reads it ends with 0 and
without a word of it. The cases are run by a child process, so that an abort or a hang in native code costs its case only.
`--case N` runs one alone and shows what it said.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from damage import BINARY, TEXT, digit, instead, jsons, one_of, table, toml, xml
from results import result
from sound_files import write_sound

from trueup import files
from trueup.cli import main as trueup
from trueup.errors import JournalError

LIMIT = 20.0
"""s of processor time that a command may take; three times as long by the clock, which others slow down."""
_TABLES = {"log.csv": b",", "semicolons.csv": b";", "blanks.txt": b" ", "drive.csv": b","}
LOGS = (
    *_TABLES,
    "lists.csv",
    "log.json",
    "log.jsonl",
    "log.npz",
    "log.npy",
    "own.parquet",
    "foreign.parquet",
    "bag_sqlite",
    "bag_mcap",
)
KINDS = {"log": 0.5, "mapping": 0.1, "parameters": 0.08, "model": 0.14, "plan": 0.08, "journal": 0.1}
"""What is damaged, and its share of the cases."""


_HUNG = "hung"


class TooSlow(BaseException):
    """A command did not end in time; no Exception, so that nothing takes it for an error in a file."""


def damaged(rng: np.random.Generator, sound: Path, kind: str) -> tuple[list[Sequence[str]], str, bool]:
    """Puts a damaged file into this folder; the commands to run, what was done, and whether it differs from the sound one."""
    if kind == "log":
        name = str(one_of(rng, LOGS))
        commands = _for_log(rng, name)
    else:
        name, commands = _for_setting(rng, kind)
    for needed in {"mapping": ("log.csv",), "parameters": ("arm.xml", "log.csv"), "plan": ("cart_pole.py", "parameters.toml"),
                   "journal": ("cart_pole.py", "parameters.toml", "plan.toml"), "log": ("arm.xml", "car.toml", "arm.urdf"),
                   "model": ("log.csv", "drive.csv")}[kind]:  # fmt: skip
        shutil.copy(sound / needed, needed)
    if kind == "journal":
        shutil.copytree(sound / "campaign", "campaign")
        target = Path("campaign") / str(
            one_of(rng, ("journal.jsonl",) * 6 + ("times.jsonl", "origin.json", "plan.toml"))
        )
    elif (sound / name).is_dir():
        shutil.copytree(sound / name, name)
        target = one_of(rng, sorted(p for p in Path(name).iterdir()))
    else:
        target = Path(shutil.copy(sound / name, name))
    before = target.read_bytes()
    if rng.random() < 0.04:
        instead(rng, target)
        return commands, f"{name}: {target.name} replaced", True
    data, how = before, []
    for _ in range(int(rng.integers(1, 3))):
        damage = one_of(rng, _damages(target))
        how.append(getattr(damage, "__name__", "table"))
        with contextlib.suppress(ValueError, IndexError, OverflowError):
            data = damage(rng, data)
    target.write_bytes(data)
    return commands, f"{name}: {target.name} {', '.join(how)}", data != before and not _same_origin(target, before)


def _same_origin(target: Path, before: bytes) -> bool:
    """Where a campaign's plan stands and its seed, in another encoding, or without the checksum that older ones lack."""
    if target.name != "origin.json":
        return False
    try:
        now, was = json.loads(files.text(target, JournalError)), json.loads(before)
        return {**was, **now} == was and {"plan", "seed"} <= set(now)
    except (JournalError, ValueError, TypeError):
        return False


def _damages(target: Path) -> Sequence:
    suffix = target.suffix
    if target.name in _TABLES:
        own = lambda rng, data: table(rng, data, _TABLES[target.name])  # noqa: E731
        return (*TEXT, *(own,) * 8)
    own = {".toml": toml, ".json": jsons, ".jsonl": jsons, ".xml": xml, ".urdf": xml}.get(suffix)
    if target.name == "journal.jsonl":
        return (*TEXT, *(digit,) * 4, *(jsons,) * 3)
    return (*TEXT, *(own,) * 6) if own else BINARY


def _for_log(rng: np.random.Generator, name: str) -> list[Sequence[str]]:
    commands: list[Sequence[str]] = [("inspect", name)]
    model = "car.toml" if name == "drive.csv" else "arm.xml"
    draw = rng.random()
    if draw < 0.25:
        commands.append(("replay", model, name))
    elif draw < 0.4:
        commands.append(("calibrate", model, name, "--dry-run"))
    elif draw < 0.44:
        commands.append(("identify", "arm.urdf", name, "--out", "model", "--friction", "common"))
    elif draw < 0.48:
        commands.append(("inspect", name, "--model", model, "--json"))
    return commands


def _for_setting(rng: np.random.Generator, kind: str) -> tuple[str, list[Sequence[str]]]:
    if kind == "mapping":
        return "map.toml", [one_of(rng, (("inspect", "log.csv", "--mapping", "map.toml"),
                                         ("inspect", "log.csv", "--mapping", "map.toml", "--json")))]  # fmt: skip
    if kind == "parameters":
        first = ("calibrate", "arm.xml", "log.csv", "--dry-run", "--parameters", "kp.toml")
        return "kp.toml", [
            first,
            *([("replay", "arm.xml", "log.csv", "--parameters", "kp.toml")] if rng.random() < 0.3 else []),
        ]
    if kind == "model":
        name = str(one_of(rng, ("arm.xml", "arm.xml", "arm.urdf", "arm.urdf", "car.toml")))
        log = "drive.csv" if name == "car.toml" else "log.csv"
        commands = [("calibrate", name, log, "--dry-run"), ("replay", name, log), ("inspect", log, "--model", name)]
        if name != "car.toml":
            commands.append(("identify", name, log, "--out", "model", "--friction", "common"))
        return name, [one_of(rng, commands)]
    if kind == "plan":
        return "plan.toml", [("run", "plan.toml", "--dry-run")]
    return "campaign", [("status", "campaign"), ("resume", "campaign", "--yes", "-q")]


def run_case(seed: int, number: int, sound: Path, *, show: bool = False) -> dict[str, object]:
    """One case in a folder of its own: what was done, and what went wrong ('' if nothing)."""
    rng = np.random.default_rng((seed, number))
    kind = str(rng.choice(list(KINDS), p=np.array(list(KINDS.values()))))
    home = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            commands, how, differs = damaged(rng, sound, kind)
            believed = differs and kind == "journal" and "times.jsonl" not in how  # instants decide nothing
            wrong = "" if not show else print(kind, how, commands)
            took, silent = 0.0, False
            for command in commands:
                began = time.process_time()
                code, said, problem = called(command)
                took = max(took, time.process_time() - began, 1.01 * LIMIT if problem == _HUNG else 0.0)
                if show:
                    print(f"$ trueup {' '.join(command)}   -> {code}\n{said}")
                wrong = wrong or (problem if problem != _HUNG else "")
                silent |= believed and code == 0 and not re.search(r"journal|note", said)
            found = {"number": number, "kind": kind, "how": how, "wrong": wrong or "", "seconds": took}
            return {**found, "slow": took > LIMIT, "silent": silent}
        finally:
            os.chdir(home)


def called(command: Sequence[str]) -> tuple[int | None, str, str]:
    """Exit code, all that was printed, and the end of the traceback of an error that was none of trueup's."""
    said = io.StringIO()

    def late(*_: object) -> None:
        raise TooSlow

    signal.signal(signal.SIGALRM, late)
    signal.alarm(int(3 * LIMIT))
    code, problem = None, ""
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            code = trueup(list(command))
    except TooSlow:
        problem = _HUNG
    except BaseException as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        ours = [f for f in traceback.extract_tb(error.__traceback__) if "trueup" in f.filename]
        own = f" from {Path(ours[-1].filename).name}:{ours[-1].lineno} {ours[-1].name}" if ours else ""
        place = f"{Path(where.filename).name}:{where.lineno}{own}"
        problem = f"{command[0]}: {type(error).__name__}: {str(error)[:150]!r} at {place}"
    finally:
        signal.alarm(0)
    text = said.getvalue()
    if not problem and (found := re.search(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]", text)):
        problem = f"{command[0]}: printed the control character {found[0]!r}"
    return code, text, problem


def in_child(seed: int, numbers: Sequence[int], sound: Path, log: Path) -> None:
    """Runs cases in a child process, which appends a line for each to `log`; ends when it ends or hangs."""
    child = os.fork()
    if child == 0:
        try:
            quiet = os.open(os.devnull, os.O_RDWR)
            for standard in (0, 1, 2):
                os.dup2(quiet, standard)
            resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
            with log.open("a") as file:
                for number in numbers:
                    file.write(json.dumps(run_case(seed, number, sound)) + "\n")
                    file.flush()
        finally:
            os._exit(0)
    size, since = -1, time.monotonic()
    while os.waitpid(child, os.WNOHANG)[0] == 0:
        now = log.stat().st_size if log.exists() else 0
        if now != size:
            size, since = now, time.monotonic()
        if time.monotonic() - since > 9 * LIMIT:
            os.kill(child, signal.SIGKILL)
        time.sleep(0.2)


def run_all(count: int, seed: int) -> list[dict[str, object]]:
    """All cases; one that ended its process, or hung in it, is wrong."""
    done: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory() as folder:
        sound, log = Path(folder) / "sound", Path(folder) / "done.jsonl"
        write_sound(sound)
        number = 0
        while number < count:
            log.unlink(missing_ok=True)
            in_child(seed, range(number, min(number + 250, count)), sound, log)
            rows = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
            done += rows
            number += len(rows)
            if len(rows) < min(250, count - number + len(rows)):
                done.append({"number": number, "kind": "?", "how": "?", "wrong": "the process ended or hung in native code",
                             "seconds": 0.0, "slow": False, "silent": False})  # fmt: skip
                number += 1
    return done


def main() -> None:
    """Prints what went wrong, by place, and the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="some hundred cases")
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--case", type=int, help="this one alone, with what the commands say")
    asked = parser.parse_args()
    if asked.case is not None:
        with tempfile.TemporaryDirectory() as folder:
            write_sound(Path(folder) / "sound")
            print(run_case(asked.seed, asked.case, Path(folder) / "sound", show=True))
        return
    began = time.process_time()
    rows = run_all(400 if asked.quick else asked.count, asked.seed)
    wrong = [r for r in rows if r["wrong"]]
    first = {str(r["wrong"]): r["number"] for r in reversed(wrong)}
    for what, times in Counter(str(r["wrong"]) for r in wrong).most_common():
        print(f"{times:5} x {what}   (--case {first[what]})")
    for r in (r for r in rows if r["slow"] or r["silent"]):
        print(f"case {r['number']}: {'slow' if r['slow'] else 'believed'}: {r['how']} ({r['seconds']:.1f} s)")
    by_kind = Counter(str(r["kind"]) for r in rows)
    slowest = max(rows, key=lambda r: float(str(r["seconds"])))
    print(f"{len(rows)} cases ({', '.join(f'{n} {k}' for k, n in by_kind.items())}), slowest {slowest['seconds']:.1f} s "
          f"(case {slowest['number']}), {time.process_time() - began:.0f} s CPU here")  # fmt: skip
    result("tracebacks", len(wrong), "", 0)
    result("slow_cases", sum(bool(r["slow"]) for r in rows), "", 0)
    silent = sum(bool(r["silent"]) for r in rows)
    result("silent_journals", silent, "", 0, peer="campaigns damaged", peer_value=by_kind["journal"])


if __name__ == "__main__":
    sys.exit(main())
