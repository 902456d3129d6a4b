# SPDX-License-Identifier: Apache-2.0
"""`--cluster` and `--quorum`: where a command simulates its candidates."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING

from rich.console import Console

from trueup.commands.console import notes

if TYPE_CHECKING:
    from trueup.evaluation.evaluator import Evaluator

CLUSTER = """\
  trueup run --cluster local:4                       four workers on this machine
  trueup run --cluster tcp://head:8786 --quorum 0.8  a dask scheduler (`dask scheduler`, `dask worker tcp://head:8786`)
  trueup run --cluster slurm:50                      fifty jobs of Slurm (htcondor:50: of HTCondor); docs/scaling.md

Needs pip install 'trueup[cluster]'. The result is that of one machine, whichever workers are lost on the way, unless a
quorum below 1 goes on without the last of each generation.
"""


def add_cluster(parser: argparse.ArgumentParser) -> None:
    """The options."""
    parser.add_argument("--cluster", metavar="ADDRESS",
                        help="simulate candidates on a cluster: local:N, tcp://HOST:PORT, slurm:N, htcondor:N")  # fmt: skip
    parser.add_argument("--quorum", type=float, metavar="SHARE",
                        help="go on when so many of a generation are back from the cluster (default: 1, all)")  # fmt: skip


def evaluator_of(
    cluster: str, quorum: float, console: Console, *, quiet: bool = False,
    watch: Callable[[int, int, int], None] | None = None,
) -> Evaluator:  # fmt: skip
    """What evaluates candidates: this process where no cluster is named. It is to be closed.

    Raises EvaluationError for a cluster that does not answer; one that is still to be started is started when it is needed.
    """
    from trueup.evaluation.evaluator import Here

    if not cluster:
        return Here()
    from trueup.evaluation.cluster import Cluster

    made = Cluster(cluster, quorum=quorum, say=lambda line: notes(console, [line], quiet=quiet), watch=watch)
    if "://" in cluster:
        made.__enter__()
    return made
