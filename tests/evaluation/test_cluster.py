# SPDX-License-Identifier: Apache-2.0
"""A cluster on this machine's loopback: the numbers of one process, whatever its workers and candidates do."""

from __future__ import annotations

import contextlib
import importlib.metadata
import os
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.engines.simulator import Simulator
from trueup.errors import EvaluationError
from trueup.evaluation.evaluator import Here, Outcome, Work
from trueup.tasks.task import Task, judged, judgement
from trueup.testing import check_evaluator
from trueup.trial import Trial

pytest.importorskip("distributed", reason="the extra 'cluster' is not installed: pip install 'trueup[cluster]'")

from trueup.evaluation.cluster import Cluster

Array = NDArray[np.float64]

SAID: list[str] = []


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    with Cluster("local:2", grace=1.0, say=SAID.append) as made:
        yield made


@pytest.fixture(autouse=True)
def both(cluster: Cluster) -> None:
    """Two workers at the beginning of each test."""
    for _ in range(200):
        cluster._roster.look()
        if cluster.workers == 2:
            return SAID.clear()
        time.sleep(0.1)
    pytest.fail("a worker did not come back")


def at(cluster: Cluster) -> str:
    """Its scheduler's address."""
    return cluster._roster.connection.cluster.scheduler_address


def squares(rows: Array, first: int) -> Outcome:
    time.sleep(0.02)
    return Outcome(rows**2)


def once(mark: Path, what: str, rows: Array, first: int) -> Outcome:
    """One worker, once, dies, hangs, or answers something else; candidate 3 does."""
    if 3.0 in rows and not mark.exists():
        mark.touch()
        if what == "dies":
            os.kill(os.getpid(), signal.SIGKILL)
        if what == "hangs":
            time.sleep(1e3)
        return Outcome({"wrong shape": np.zeros((1, 7)), "NaN": np.full((len(rows), 1), np.nan)}[what])
    return squares(rows, first)


def dying_once(
    mark: Path, task: Task, simulator: Simulator, trials: Sequence[Trial], rows: Array, first: int
) -> Outcome:
    """A walk's scores, by a worker that is killed in the midst of its first chunk."""
    if not mark.exists():
        mark.touch()
        threading.Timer(0.1, lambda: os.kill(os.getpid(), signal.SIGKILL)).start()
    return judged(task, simulator, trials, rows, first)


def poisoned(rows: Array, first: int) -> Outcome:
    if 3.0 in rows:
        os.kill(os.getpid(), signal.SIGKILL)
    return squares(rows, first)


def faulty(rows: Array, first: int) -> Outcome:
    if 3.0 in rows:
        raise ZeroDivisionError("a leg of no length")
    return squares(rows, first)


def broken(rows: Array, first: int) -> Outcome:
    raise ZeroDivisionError("a leg of no length")


def slow(rows: Array, first: int) -> Outcome:
    time.sleep(30.0 if 3.0 in rows else 0.05)
    return squares(rows, first)


ROWS = np.linspace(0.0, 11.0, 12)[:, None]


def test_a_cluster_keeps_the_contract(cluster: Cluster) -> None:
    check_evaluator(Here())
    check_evaluator(cluster)


@pytest.mark.parametrize("what", ["dies", "hangs", "wrong shape", "NaN"])
def test_what_one_worker_does_once_changes_nothing(cluster: Cluster, tmp_path: Path, what: str) -> None:
    cluster.evaluate(Work(squares, (), kind=what), ROWS)  # how long it takes
    done = cluster.evaluate(Work(once, (tmp_path / "done", what), kind=what), ROWS)
    assert (tmp_path / "done").exists()
    np.testing.assert_array_equal(done.values, ROWS**2)
    assert not done.failures
    words = {
        "dies": "was lost",
        "hangs": "hangs: no answer",
        "wrong shape": "shape (1, 7)",
        "NaN": "NaN, and no reason",
    }
    assert any(words[what] in line for line in SAID), SAID


@pytest.mark.parametrize("work", [poisoned, faulty])
def test_a_candidate_that_harms_is_found_and_the_others_are_scored(
    cluster: Cluster, work: Callable[..., Outcome]
) -> None:
    done = cluster.evaluate(Work(work, ()), ROWS)
    assert list(done.failures) == [3]
    assert "was lost" in done.failures[3] or "a leg of no length" in done.failures[3]
    np.testing.assert_array_equal(np.delete(done.values, 3, axis=0), np.delete(ROWS**2, 3, axis=0))


def test_what_goes_wrong_everywhere_is_said_at_once(cluster: Cluster) -> None:
    with pytest.raises(EvaluationError, match="the same goes wrong: ZeroDivisionError: a leg of no length"):
        cluster.evaluate(Work(broken, ()), np.linspace(0.0, 1.0, 200)[:, None])


def test_a_quorum_does_not_wait_for_the_last(cluster: Cluster) -> None:
    with Cluster(at(cluster), quorum=0.5) as hasty:
        begun = time.monotonic()
        done = hasty.evaluate(Work(slow, ()), ROWS)
    assert time.monotonic() - begun < 10.0
    assert np.isfinite(done.values).sum() == 6
    assert set(done.failures) == set(range(6))
    assert "not among the first 50 %" in done.failures[3]


def test_a_walk_scores_bit_by_bit_as_in_one_process_with_a_worker_killed_on_the_way(
    cluster: Cluster, tmp_path: Path
) -> None:
    from trueup.studies.walk.scenes import simulator, task
    from trueup.tasks.walking import WalkFront

    walk, engine = task(WalkFront, runs=1, seconds=1.0), simulator()
    start = walk.parameters.to_unit(walk.parameters.nominal)
    unit = np.clip(start + 0.1 * np.random.default_rng(0).standard_normal((6, len(start))), 0.0, 1.0)
    rows = walk.parameters.from_unit(unit)
    here = Here().evaluate(judgement(walk, engine), rows)
    work = judgement(walk, engine)
    there = cluster.evaluate(Work(dying_once, (tmp_path / "done", *work.parts), work.width, work.kind), rows)
    np.testing.assert_array_equal(there.values, here.values)
    assert np.ptp(here.values[:, 0]) > 0.0
    assert any("was lost" in line or "hangs" in line for line in SAID), SAID  # on a busy machine the limit may be first


def test_a_worker_of_another_version_is_refused_by_name(cluster: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    real = importlib.metadata.version
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "3.3.0" if name == "mujoco" else real(name))
    with pytest.raises(EvaluationError, match=rf"worker tcp.* has mujoco {real('mujoco')} \(here 3.3.0\)"):
        Cluster(at(cluster)).__enter__()


def test_a_scheduler_that_dies_ends_it_in_a_sentence() -> None:
    with Cluster("local:1") as doomed:
        doomed.evaluate(Work(squares, ()), ROWS)
        threading.Timer(0.5, doomed._roster.connection.cluster.close).start()
        with pytest.raises(
            EvaluationError, match=r"scheduler of the cluster 'local:1' does not answer|no worker is left"
        ):
            doomed.evaluate(Work(slow, ()), ROWS)


def test_a_client_that_closes_between_its_status_and_a_question_is_a_scheduler_that_is_gone(cluster: Cluster) -> None:
    def ask(_: object) -> None:
        raise RuntimeError("ConnectionPool is closed")

    with pytest.raises(EvaluationError, match=r"scheduler of the cluster 'local:2' does not answer"):
        cluster._roster.answer(ask)


@contextlib.contextmanager
def coming_within(seconds: int) -> Iterator[None]:
    """A queue may keep its jobs waiting for ever, and so does who waits for them: not here."""

    def late(*_: object) -> None:
        pytest.skip(f"the worker of the job that is played did not come within {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


SBATCH = """#!/bin/sh
if test -e "{refuse}"; then echo 'invalid account' >&2; exit 1; fi
cp "$1" "{kept}"  # the script is gone when this returns
setsid sh "{kept}" > /dev/null 2>&1 &
echo "Submitted batch job $!"
"""


@pytest.mark.skipif(shutil.which("setsid") is None, reason="the queue that is played here needs the command setsid")
def test_jobs_of_slurm_are_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Slurm itself is played: sbatch runs the job script here, scancel ends it."""
    from dask import config

    for name, text in {
        "sbatch": SBATCH.format(refuse=tmp_path / "no", kept=tmp_path / "job.sh"),
        "scancel": '#!/bin/sh\nkill -- "-$1"\n',
    }.items():
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    local = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"}
    with coming_within(60), config.set({"jobqueue.slurm.scheduler-options": local}):
        with Cluster("slurm:1") as jobs:
            np.testing.assert_array_equal(jobs.evaluate(Work(squares, ()), ROWS).values, ROWS**2)
        (tmp_path / "no").touch()
        with pytest.raises(EvaluationError, match=r"no cluster at 'slurm:1'.*invalid account.*jobqueue.yaml"):
            Cluster("slurm:1").__enter__()


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("tcp://127.0.0.1:9", "no cluster at 'tcp://127.0.0.1:9'.*Does its scheduler run"),
        ("localhost", "is no address of a cluster; it may be tcp://HOST:PORT"),
        ("local:0", "is no address"),
        ("slurm", "slurm:N"),
        ("htcondor:3", "needs the command condor_submit"),
    ],
)
def test_an_address_that_leads_nowhere_is_named(address: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trueup.evaluation.connection.ANSWER", 1.0)
    with pytest.raises(EvaluationError, match=said):
        Cluster(address).__enter__()
