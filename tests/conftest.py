# SPDX-License-Identifier: Apache-2.0
"""Fixtures that all tests share: a seeded generator, the recordings of real robots, a settled hypothesis."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

ROOT = Path(__file__).resolve().parents[1]

# A deadline would fail on a busy machine. The same examples are tried each time, so that a red run is a change's doing
# and can be had again; `TRUEUP_FUZZ=1 make test` looks for new ones.
settings.register_profile("fuzz", deadline=None, print_blob=True)
settings.register_profile("fixed", deadline=None, derandomize=True, database=None, print_blob=True)
settings.load_profile("fuzz" if os.environ.get("TRUEUP_FUZZ") else "fixed")


def pytest_configure(config: pytest.Config) -> None:
    """Throws compiled kernels away that are older than any kernel's source: numba looks at a kernel's own file alone, and
    would run what calls another one as that was before.
    """
    if hasattr(config, "workerinput"):
        return
    source = ROOT / "src"
    kernels = [path for path in source.rglob("*.py") if "njit" in path.read_text(encoding="utf-8")]
    newest = max(path.stat().st_mtime for path in kernels)
    for compiled in source.rglob("*.nb[ic]"):
        if compiled.stat().st_mtime < newest:
            compiled.unlink(missing_ok=True)


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator that gives the same numbers in each run of each test."""
    return np.random.default_rng(0)


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of recordings of real robots; a test that asks for it is skipped where there is none."""
    said = os.environ.get("TRUEUP_DATA")
    folder = Path(said) if said else ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        where = f"TRUEUP_DATA={said} is not a folder" if said else "set TRUEUP_DATA to their folder"
        pytest.skip(f"no recordings of real robots here: {where}")
    return folder
