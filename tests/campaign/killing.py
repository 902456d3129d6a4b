# SPDX-License-Identifier: Apache-2.0
"""Runs a campaign in child processes that are killed, resumes each, and prints what differs from an undisturbed run.

As a script: FOLDER KILLS SEED [forgetful]. Everything is imported once and each campaign runs in a fork, so that a kill
costs no start of Python. Half of the kills come at random moments, half right before or after a random call of those
that make something last (fsync, replace, rename, link).
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import trueup.formats  # noqa: F401 - loaded once, before the forks
from trueup.campaign.campaign import Campaign
from trueup.campaign.folder import Folder
from trueup.campaign.journal import JOURNAL, Journal
from trueup.campaign.parts import Silent
from trueup.campaign.plan import read_plan
from trueup.campaign.resolve import parts_of

LASTING = ("fsync", "replace", "rename", "link")

PLAN = """
name = "killed"
seed = 5
[robot]
type = "toy:Cart"
folder = "../{folder}/performed"
forgetful = {forgetful}
[simulator]
type = "toy:Lag"
[task]
type = "toy:Follow"
[calibrate]
method = "toy:regression"
[experiment]
settings = 2
[optimize]
search = {{ type = "toy:Nearby", generation = 5, generations = 4 }}
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


def main(folder: Path, kills: int, seed: int, forgetful: bool) -> None:
    """Prints one JSON line: kills that struck, journals that differ, trials lost or performed more than once."""
    rng = random.Random(seed)
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(Path(__file__).with_name("toy.py"), folder)
    plan = folder / "campaign.toml"

    def prepared(name: str) -> Path:
        plan.write_text(PLAN.format(folder=f"{folder.name}/{name}", forgetful=str(forgetful).lower()))
        return folder / name

    reference = prepared("run")
    began = time.perf_counter()
    in_child(lambda: campaign(reference, plan))
    lasts = time.perf_counter() - began
    wanted = (reference / JOURNAL).read_bytes()
    performed = sorted(p.name for p in (reference / "performed").glob("trial-*"))
    shutil.rmtree(reference)
    in_child(calls_of(lambda: campaign(prepared("run"), plan), folder / "calls"))
    calls = int((folder / "calls").read_text())
    struck = differ = twice = lost = unknown = 0
    while struck < kills:
        if reference.exists():
            shutil.rmtree(reference)
        ended = _killed(lambda: campaign(reference, plan), struck, rng, lasts, calls)
        if ended:
            continue
        struck += 1
        if rng.random() < 0.3 and not _killed(lambda: campaign(reference, plan), struck, rng, lasts, calls):
            struck += 1
        in_child(lambda: campaign(reference, plan))
        text = (reference / JOURNAL).read_bytes()
        differ += text != wanted
        if forgetful:
            lines = (reference / "performed" / "performed.txt").read_text().split()
            twice += len(lines) - len(set(lines))
            unknown += text.count(b'"outcome":"unknown"')
        else:
            lost += sorted(p.name for p in (reference / "performed").glob("trial-*")) != performed
    print(json.dumps({"struck": struck, "differ": differ, "lost": lost, "twice": twice, "unknown": unknown,
                      "seconds": lasts, "calls": calls}))  # fmt: skip


def _killed(work: Callable[[], None], turn: int, rng: random.Random, lasts: float, calls: int) -> bool:
    """One run that is killed at random; True if it came to its end before."""
    if turn % 2:
        return in_child(work, after=rng.uniform(0.0, lasts))
    return in_child(dying(work, rng.randint(1, calls), before=rng.random() < 0.5))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), "forgetful" in sys.argv[4:])
