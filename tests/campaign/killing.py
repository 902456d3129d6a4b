# SPDX-License-Identifier: Apache-2.0
"""Runs a campaign in child processes that are killed, resumes each, and prints what differs from an undisturbed run.

As a script: FOLDER KILLS SEED [forgetful | by-hand]. Everything is imported once and each campaign runs in a fork, so
that a kill costs no start of Python. Half of the kills come at random moments, half right before or after a random call
of those that make something last (fsync, replace, rename, link).
"""

from __future__ import annotations

import dataclasses
import importlib
import json
import os
import random
import shutil
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from trueup.campaign.campaign import Campaign
from trueup.campaign.folder import Folder
from trueup.campaign.journal import JOURNAL, Journal
from trueup.campaign.parts import Silent
from trueup.campaign.plan import read_plan
from trueup.campaign.resolve import parts_of
from trueup.formats import write
from trueup.recording import Channel, Recording

ROBOTS = {
    "": 'type = "toy:Cart"\nfolder = "../{folder}/performed"',
    "forgetful": 'type = "toy:Cart"\nfolder = "../{folder}/performed"\nforgetful = true',
    "by-hand": 'type = "by-hand"\npoll = 0.01\nrest = 0.05',
}

LASTING = ("fsync", "replace", "rename", "link")

PLAN = """
name = "killed"
seed = 5
[robot]
{robot}
[simulator]
type = "toy:Lag"
[task]
type = "toy:Follow"
[calibrate]
method = "toy:regression"
[experiment]
settings = 2
[optimize]
search = {{ type = "toy:Nearby", generation = 3, generations = 2 }}
samples = 3
trust = 0.3
[transfer]
candidates = 2
[stop]
rounds = 2
"""


def campaign(folder: Path, plan: Path) -> None:
    """One campaign, begun or resumed, to its end."""
    home = Folder.begin(read_plan(plan), folder, None)
    with Journal(home.path) as journal:
        Campaign(home.file.plan, home.checksum, "0", parts_of(home.file, home.path, print), journal, Silent()).run()


def in_child(work: Callable[[], None], after: float | None = None) -> bool:
    """Runs `work` in a fork, kills it `after` seconds; True if it came to its end. Raises where it failed by itself."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            work()
            code = 0
        finally:
            sys.stdout.flush()
            os._exit(code)
    if after is not None:
        time.sleep(after)
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        return False
    if os.WEXITSTATUS(status):
        raise SystemExit("the campaign failed by itself")
    return True


def dying(work: Callable[[], None], call: int, *, before: bool) -> Callable[[], None]:
    """`work`, whose process kills itself right before or after its `call`-th call that makes something last."""

    def run() -> None:
        count = 0

        def wrapped(original: Callable[..., object]) -> Callable[..., object]:
            def instead(*args: object, **more: object) -> object:
                nonlocal count
                count += 1
                if count == call and before:
                    os.kill(os.getpid(), signal.SIGKILL)
                result = original(*args, **more)
                if count == call:
                    os.kill(os.getpid(), signal.SIGKILL)
                return result

            return instead

        for name in LASTING:
            setattr(os, name, wrapped(getattr(os, name)))
        work()

    return run


def calls_of(work: Callable[[], None], note: Path) -> Callable[[], None]:
    """`work`, leaving in `note` how many such calls it made."""

    def run() -> None:
        count = [0]
        for name in LASTING:
            original = getattr(os, name)

            def instead(*args: object, original: Callable[..., object] = original, **more: object) -> object:
                count[0] += 1
                return original(*args, **more)

            setattr(os, name, instead)
        work()
        note.write_text(str(count[0]))

    return run


def operate(folder: Path) -> None:
    """An operator, for ever: performs on the toy's robot what lies in outbox/, once each, and drops the logs."""
    toy = importlib.import_module("toy")
    cart, done = toy.Cart(), set()
    while True:
        for sheet in sorted((folder / "outbox").glob("trial-*")):
            if sheet.name not in done and (folder / "inbox").exists():
                settings = json.loads((sheet / "trial.json").read_text())["settings"]
                trial = dataclasses.replace(toy.Follow().trials[0], name=sheet.name, settings=settings)
                (r,) = cart.perform(trial)
                rows = np.column_stack([r.time, r.channel("position").values, r.channel("command").values])
                np.savetxt(folder / "inbox" / f"{sheet.name}.csv", rows, delimiter=",", fmt="%.12g",
                           header="time,position/x,command/x", comments="")  # fmt: skip
                done.add(sheet.name)
        time.sleep(0.01)


def beside(work: Callable[[], None]) -> int:
    """Runs `work` in a fork of its own; returns its id."""
    child = os.fork()
    if child == 0:
        try:
            work()
        finally:
            os._exit(1)
    return child


def main(folder: Path, kills: int, seed: int, robot: str) -> None:
    """Prints one JSON line: kills that struck, journals that differ, trials lost or performed more than once."""
    rng = random.Random(seed)
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(Path(__file__).with_name("toy.py"), folder)
    sys.path.insert(0, str(folder))
    plan, home = folder / "campaign.toml", folder / "run"
    plan.write_text(PLAN.format(robot=ROBOTS[robot].format(folder=f"{folder.name}/run")))

    def work() -> None:
        campaign(home, plan)

    now = np.arange(2.0)
    write(
        Recording("once", {"x": Channel("x", ("x",), "", now, now)}), folder / "once.parquet"
    )  # loads what writing needs
    began = time.perf_counter()
    _whole(work, home, robot, lambda: in_child(work))
    lasts = time.perf_counter() - began
    wanted = (home / JOURNAL).read_bytes()
    performed = _performed(home)
    _whole(work, home, robot, lambda: in_child(calls_of(work, folder / "calls")))
    calls = int((folder / "calls").read_text())
    count = {"struck": 0, "differ": 0, "lost": 0, "twice": 0, "unknown": 0}

    def disturbed() -> None:
        for _ in range(2 if rng.random() < 0.3 else 1):
            if _killed(work, count["struck"], rng, lasts, calls):
                return  # it had come to its end before
            count["struck"] += 1
            if b'"event":"Ended"' in _journal(home):
                return  # struck after the last event: there is nothing left to do
        in_child(work)

    while count["struck"] < kills:
        _whole(work, home, robot, disturbed)
        text = (home / JOURNAL).read_bytes()
        count["differ"] += text != wanted
        count["unknown"] += text.count(b'"outcome":"unknown"')
        names = _performed(home)
        count["twice"] += len(names) - len(set(names))
        count["lost"] += robot != "forgetful" and sorted(set(names)) != performed
    print(json.dumps({**count, "seconds": lasts, "calls": calls}))


def _whole(work: Callable[[], None], home: Path, robot: str, run: Callable[[], object]) -> None:
    """One campaign from nothing to its end, with an operator beside it where one is needed."""
    shutil.rmtree(home, ignore_errors=True)
    operator = beside(lambda: operate(home)) if robot == "by-hand" else 0
    run()
    if operator:
        os.kill(operator, signal.SIGKILL)
        os.waitpid(operator, 0)


def _journal(home: Path) -> bytes:
    path = home / JOURNAL
    return path.read_bytes() if path.exists() else b""


def _performed(home: Path) -> list[str]:
    """The trials that the robot performed, by its own memory; for an operator, whose logs were taken."""
    lines = home / "performed" / "performed.txt"
    if lines.exists():
        return sorted(lines.read_text().split())
    logs = [p.stem for p in (home / "accepted").glob("trial-*/trial-*.csv")]
    return sorted([p.name for p in (home / "performed").glob("trial-*")] + logs)


def _killed(work: Callable[[], None], turn: int, rng: random.Random, lasts: float, calls: int) -> bool:
    """One run that is killed at random; True if it came to its end before."""
    if turn % 2:
        return in_child(work, after=rng.uniform(0.0, lasts))
    return in_child(dying(work, rng.randint(1, calls), before=rng.random() < 0.5))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), "".join(sys.argv[4:]))
