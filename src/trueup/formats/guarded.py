# SPDX-License-Identifier: Apache-2.0
"""Reads files in a process of their own whose readers, in C, crash or never end on damaged ones: 0.3 s of processor time."""

from __future__ import annotations

import io
import json
import os
import resource
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from trueup.errors import FormatError
from trueup.formats.tree import Leaf, Tree

_LEAST, _EACH = 20, 1e-7
"""s of processor time that a file may take, and for each of its bytes: a hundred times what sound ones take."""


def guarded(reader: Callable[[Path], Tree], path: Path, what: str) -> Tree:
    """What a module's function makes of a file of the kind `what`, in another process.

    Raises FormatError where that says what is wrong, crashes, or takes too long.
    """
    root = str(Path(__file__).parents[2])
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])}
    command = [sys.executable, "-m", __name__, reader.__module__, reader.__name__, os.fspath(path)]
    try:
        done = subprocess.run(command, capture_output=True, check=False, env=environment)
    except OSError as error:
        raise FormatError(f"{path}: cannot be read ({error.strerror or error})") from None
    if done.returncode:
        said = done.stderr.decode("utf-8", "replace").strip() if done.returncode == os.EX_DATAERR else ""
        raise FormatError(f"{path}: cannot be read as {what} ({said or 'its reader crashed, so it is damaged'})")
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as arrays:
        tree = Tree()
        for number, (where, unit, names) in enumerate(json.loads(str(arrays["index"]))):
            branch = tree
            for name in where[:-1]:
                branch = branch.branches.setdefault(name, Tree())
            branch.leaves[where[-1]] = Leaf(arrays[str(number)], unit, tuple(names))
    return tree


def _child(module: str, function: str, path: str) -> int:
    """Writes a tree's arrays to standard output, and what is wrong to the other; returns the exit code."""
    limit = int(_LEAST + _EACH * os.path.getsize(path))
    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        tree: Tree = getattr(__import__(module, fromlist=[function]), function)(Path(path))
    except Exception as error:  # damaged bytes surface as many kinds of error
        sys.stderr.write(" ".join(str(error).split())[:200] or type(error).__name__)
        return os.EX_DATAERR
    every = list(tree.every())
    index = json.dumps([[where, leaf.unit, leaf.names] for where, leaf in every])
    arrays: Mapping[str, np.ndarray] = {str(k): leaf.values for k, (_, leaf) in enumerate(every)}
    np.savez(sys.stdout.buffer, index=np.array(index), allow_pickle=False, **arrays)
    return 0


if __name__ == "__main__":
    sys.exit(_child(*sys.argv[1:]))
