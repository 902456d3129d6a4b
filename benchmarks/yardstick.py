# SPDX-License-Identifier: Apache-2.0
"""What other tools' core work costs on this machine now: seconds mean nothing alone, machines differ by a factor of two."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import mujoco
import numpy as np
from regressor import arm, in_pinocchio

_SAMPLES = 20_000

PINOCCHIO = "pinocchio's regressor in a loop"
REPLAYS = "a thousand replays of what is fitted, by MuJoCo's own steps in a loop"
READ = "numpy.loadtxt and pinocchio's regressor in a loop, in a process of its own"


def pinocchio_seconds(samples: float) -> float:
    """CPU seconds of pinocchio's joint-torque regressor of a 6-joint arm, called for each of `samples`: what FIGAROH and
    FloBaRoID do for a log or an individual. Measured on `_SAMPLES` of them, the best of three.
    """
    import pinocchio as pin  # pyright: ignore[reportMissingImports]

    model = in_pinocchio(arm())
    data, rng = model.createData(), np.random.default_rng(0)
    motion = rng.uniform(-1.0, 1.0, (3, _SAMPLES, 6))
    times = []
    for _ in range(3):
        begun = time.process_time()
        for q, qd, qdd in zip(*motion, strict=True):
            pin.computeJointTorqueRegressor(model, data, q, qd, qdd)
        times.append(time.process_time() - begun)
    return samples / _SAMPLES * min(times)


def replay_seconds(xml: str, duration: float, times: int) -> float:
    """CPU seconds of stepping a model with one actuator for `times` times `duration` s, a command set at each step: what a
    search of so many trials costs that replays logs in a plain loop. Measured on `_SAMPLES` steps, the best of three.
    """
    model = mujoco.MjModel.from_xml_string(xml)
    data, measured = mujoco.MjData(model), []
    for _ in range(3):
        mujoco.mj_resetData(model, data)
        commands = np.sin(0.01 * np.arange(_SAMPLES))
        begun = time.process_time()
        for command in commands:
            data.ctrl[0] = command
            mujoco.mj_step(model, data)
        measured.append(time.process_time() - begun)
    return times * duration / model.opt.timestep / _SAMPLES * min(measured)


def plain_identification_seconds(files: list[Path]) -> float:
    """Wall seconds, the best of three, of the least that any identification does: a process starts, reads tables of six
    columns as numpy does, and computes pinocchio's regressor for each row.
    """
    code = (
        "import sys, numpy as np\n"
        f"sys.path.insert(0, {str(Path(__file__).resolve().parent)!r})\n"
        "from regressor import arm, in_pinocchio\n"
        "import pinocchio as pin\n"
        "tables = [np.loadtxt(f, delimiter=',', skiprows=1) for f in sys.argv[1:]]\n"
        "model = in_pinocchio(arm()); data = model.createData()\n"
        "for row in tables[0][:, -6:]:\n"
        "    pin.computeJointTorqueRegressor(model, data, row, row, row)\n"
    )
    times = []
    for _ in range(3):
        begun = time.perf_counter()
        subprocess.run([sys.executable, "-c", code, *map(str, files)], check=True)
        times.append(time.perf_counter() - begun)
    return min(times)
