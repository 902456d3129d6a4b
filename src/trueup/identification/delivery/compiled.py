# SPDX-License-Identifier: Apache-2.0
"""A written header as it runs: compiled by the system's C compiler, called and timed."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trueup.arrays import Array

_COMPILERS = ("cc", "gcc", "clang")


@dataclass(frozen=True, eq=False)
class Compiled:
    """A header that runs."""

    function: Any

    def torque(self, q: Array, v: Array, a: Array) -> Array:
        """(S, n) torque, sample by sample, from a fresh state."""
        given = [np.ascontiguousarray(x, dtype=np.float64) for x in (q, v, a)]
        out = np.empty_like(given[0])
        pointers = [x.ctypes.data_as(ctypes.c_void_p) for x in (*given, out)]
        self.function(len(out), *pointers)
        return out

    def seconds(self, q: Array, v: Array, a: Array) -> float:
        """Seconds a call, the best of several runs over the motion (S, n)."""
        calls = 20_000  # That are timed at least
        runs = max(5, calls // max(len(q), 1))
        taken = []
        for _ in range(runs):
            begun = time.perf_counter()
            self.torque(q, v, a)
            taken.append(time.perf_counter() - begun)
        return min(taken) / max(len(q), 1)


@contextmanager
def compiled(header: Path, prefix: str, options: Sequence[str] = ()) -> Iterator[Compiled | str]:
    """The header as it runs while the block lasts, or in words why it does not; `options` are more of the compiler's."""
    compiler = os.environ.get("CC") or next((c for c in _COMPILERS if shutil.which(c)), "")
    if not compiler or not shutil.which(compiler):
        yield f"no C compiler was found ({', '.join(_COMPILERS)})"
        return
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as scratch:
        source, library = Path(scratch) / "calls.c", Path(scratch) / "calls.so"
        source.write_text(
            f'#include "{header.absolute().as_posix()}"\n'
            f"void calls(long S, const double *q, const double *v, const double *a, double *out) {{\n"
            f"  {prefix}_state state = {{0}};\n"
            f"  for (long i = 0; i < S * {prefix}_JOINTS; i += {prefix}_JOINTS)\n"
            f"    {prefix}_torque(&state, q + i, v + i, a + i, out + i);\n}}\n",
            encoding="utf-8",
        )
        call = [compiler, "-std=c99", "-O2", "-shared", "-fPIC", *options, "-o", str(library), str(source), "-lm"]
        try:
            done = subprocess.run(call, capture_output=True, text=True, timeout=60, check=False)
        except (OSError, subprocess.SubprocessError) as error:
            yield f"{compiler} could not be run ({error})"
            return
        if done.returncode != 0:
            yield f"{compiler} refused it: {next(iter(done.stderr.strip().splitlines()), 'no reason given')}"
            return
        function = ctypes.CDLL(str(library)).calls
        function.argtypes = [ctypes.c_long, *[ctypes.c_void_p] * 4]
        function.restype = None
        yield Compiled(function)
