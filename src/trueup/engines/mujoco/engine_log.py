# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's own log: it would leave a MUJOCO_LOG.TXT in whichever folder somebody works in."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from mujoco import MjLogConfig


@contextmanager
def unlogged() -> Iterator[None]:
    """Warnings of unstable simulations stay out of files and terminals: who asked for the simulation tells of them."""
    before, quiet = MjLogConfig.get(), MjLogConfig.get()
    quiet.logto_console = quiet.logto_file = False
    quiet.set()
    try:
        yield
    finally:
        before.set()
