# SPDX-License-Identifier: Apache-2.0
"""How long a command takes to start, beside a bare import of what numerical Python needs, in turn in the same run.

Each is a process of its own that may not write byte code, as in a container or an installation that belongs to root: what
the set-up did not compile is compiled at each start. `trueup calibrate --help` is what a user waits for first; `engine` is
all that a calibration imports before it reads its first file.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys

from results import result

BARE = "import numpy, scipy.signal, numba"
COMMANDS = ("inspect", "calibrate", "replay", "identify", "excite", "run", "report")
ENGINE = "import trueup.loop.calibrate, trueup.engines.mujoco.rollout, trueup.formats, trueup.report"


def cpu_seconds(arguments: list[str]) -> float:
    """User and system time of one process, in s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Prints CPU seconds of each start, and the slowest over the bare import."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one run of each")
    runs = 1 if parser.parse_args().quick else 5
    started = {
        "bare import": ["-c", BARE],
        **{f"trueup {c} --help": ["-m", "trueup.cli", c, "--help"] for c in COMMANDS},
        "engine": ["-c", ENGINE],
    }
    for arguments in started.values():
        cpu_seconds(arguments)  # files into the machine's cache
    seconds: dict[str, list[float]] = {name: [] for name in started}
    for _ in range(runs):
        for name, arguments in started.items():
            seconds[name].append(cpu_seconds(arguments))
    medians = {name: statistics.median(values) for name, values in seconds.items()}
    for name, median in medians.items():
        print(f"{name:28} {median:6.2f} s CPU  {median / medians['bare import']:5.2f} x")
    peer = "numpy, scipy.signal, numba imported"
    slowest = max(m for name, m in medians.items() if name.startswith("trueup"))
    result("command_start", slowest, "s", 2.0, peer=peer, peer_value=medians["bare import"], ratio_goal=True)
    result("engine_start", medians["engine"], "s", 2.0, peer=peer, peer_value=medians["bare import"], ratio_goal=True)


if __name__ == "__main__":
    main()
