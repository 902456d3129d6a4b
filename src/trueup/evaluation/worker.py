# SPDX-License-Identifier: Apache-2.0
"""What runs on a worker of a cluster: says who it is, keeps what it was sent, and works on chunks of rows."""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
import pickle
import platform
import signal
import sys
import sysconfig
import time
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

from trueup.arrays import Array
from trueup.cores import THREADS
from trueup.errors import EvaluationError, TrueupError
from trueup.evaluation.evaluator import Outcome

_SAME = ("trueup", "mujoco", "numpy", "numba", "scipy")


@dataclass
class Kept:
    """Parts that a worker was sent, by the hash of their bytes."""

    parts: dict[str, Any] = field(default_factory=dict)

    def get(self, key: str) -> Any:
        """A part, which is now the one used last. Raises KeyError."""
        self.parts[key] = part = self.parts.pop(key)
        return part

    def put(self, key: str, blob: bytes) -> None:
        """Takes a part as `packed` made it."""
        kept = 16  # parts that a worker holds at a time, those used last
        self.parts[key] = pickle.loads(zlib.decompress(blob))  # from the client that this worker serves, as its code is
        for old in list(self.parts)[:-kept]:
            del self.parts[old]


@dataclass(frozen=True, eq=False)
class Reply:
    """What a worker says of a chunk."""

    outcome: Outcome | None = None
    seconds: float = 0.0
    """That the work took."""
    missing: tuple[str, ...] = ()
    """Parts that it has not, or no more: nothing was done."""
    error: str = ""
    """What was raised."""
    raised: TrueupError | None = None
    """The same, where it is an error that trueup raises on purpose: it would be raised here too."""


def packed(part: object) -> tuple[str, bytes]:
    """A part as it travels, and the hash of its bytes: with the code of modules that are not installed, a user's own.

    Raises EvaluationError for what cannot travel.
    """
    import cloudpickle

    own = [m for m in list(sys.modules.values()) if _is_own(m)]
    for module in own:
        cloudpickle.register_pickle_by_value(module)
    try:
        blob = zlib.compress(cloudpickle.dumps(part), 1)
    except Exception as error:  # whatever a user's class raises
        raise EvaluationError(
            f"a {type(part).__name__} cannot be sent to workers: {error}; say what is sent of it in its __getstate__"
        ) from error
    finally:
        for module in own:
            cloudpickle.unregister_pickle_by_value(module)
    return hashlib.sha256(blob).hexdigest(), blob


def _is_own(module: ModuleType) -> bool:
    """Whether a module is a plain file of the user's."""
    path, name = getattr(module, "__file__", None) or "", getattr(module, "__name__", "")
    installed = {*sysconfig.get_paths().values(), str(Path(__file__).resolve().parents[1])}
    plain = path.endswith(".py") and not any(path.startswith(root) for root in installed)
    return plain and name != "__main__" and sys.modules.get(name) is module


def work_on(keys: Sequence[str], blobs: Mapping[str, bytes], rows: Array, first: int, threads: int) -> Reply:
    """A chunk: rows (b, n) from number `first` on, in so many threads; `keys` are of the work's function and its parts.

    Parts come once, with the first chunk that needs them.
    """
    from distributed import get_worker

    kept: Kept = vars(get_worker()).setdefault("_trueup_kept", Kept())
    os.environ[THREADS] = str(threads)
    for key, blob in blobs.items():
        kept.put(key, blob)
    missing = tuple(k for k in keys if k not in kept.parts)
    if missing:
        return Reply(missing=missing)
    begun = time.perf_counter()
    try:
        function, *parts = (kept.get(k) for k in keys)
        outcome = function(*parts, rows, first)
    except TrueupError as error:
        return Reply(error=str(error), raised=error)
    except Exception as error:  # of whoever wrote the task: named to whoever runs it
        return Reply(error=f"{type(error).__name__}: {error}")
    return Reply(outcome, time.perf_counter() - begun)


def dask_setup(worker: object) -> None:
    """Called by dask in a worker of this machine: Ctrl-C is for whoever started it, who then ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def identity() -> dict[str, str]:
    """What must be the same wherever candidates are to be compared: versions, and trueup's own source."""
    root = Path(__file__).resolve().parents[1]
    source = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        source.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes())
    versions = {name: importlib.metadata.version(name) for name in _SAME}
    python = ".".join(platform.python_version_tuple()[:2])
    return {"Python": python, **versions, "trueup's source": source.hexdigest()[:12]}
