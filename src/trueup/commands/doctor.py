# SPDX-License-Identifier: Apache-2.0
"""`trueup doctor`: whether all is in place: Python, packages, extras, threads, the time of a yardstick, pictures."""

from __future__ import annotations

import argparse
import importlib.metadata
import importlib.util
import os
import platform
import shutil
import sys
import time
from dataclasses import asdict, dataclass

from rich.console import Console
from rich.markup import escape

from trueup.commands.console import tell
from trueup.commands.sources import add_shared
from trueup.cores import cores

ABOUT = """\
Looks at this machine and says what may be wrong: versions of what trueup needs, extras that are there or how to get them,
threads that would stand in each other's way, how long a yardstick takes, whether pictures can be rendered. Ends with 1 where
something needed is missing.

  trueup doctor
  trueup doctor --json
"""

_NEEDED = ("mujoco", "numpy", "scipy", "numba", "pyarrow", "rich", "plotly", "cma", "optuna")
_EXTRAS = {"rosbags": ("ros", "reads rosbag2, MCAP and ROS 1 bags"), "h5py": ("hdf5", "reads HDF5 and MATLAB 7.3 files"),
           "dartpy": ("dart", "a second engine"), "distributed": ("cluster", "more than one machine")}  # fmt: skip
_USUAL = 0.1  # s of processor time for the yardstick, on the machine of docs/benchmarks.md


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at."""

    what: str
    verdict: str
    """good, mind (works, may be better) or bad (something will not work)."""
    message: str


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What this command takes."""
    add_shared(parser, "json")


def run(args: argparse.Namespace, console: Console, told: Console) -> int:
    """Shows the findings. Returns 0, or 1 where something will not work."""
    found = [f for look in (_python, _packages, _extras, _threads, _yardstick, _rendering, _browser) for f in look()]
    if args.json:
        console.print_json(data=[asdict(f) for f in found])
    else:
        colours = {"good": "green", "mind": "yellow", "bad": "red"}
        for f in found:
            tell(console, f"[{colours[f.verdict]}]{f.verdict:5}[/] {f.what:12} {escape(f.message)}")
    return int(any(f.verdict == "bad" for f in found))


def _python() -> list[Finding]:
    fine = sys.version_info >= (3, 11)
    return [
        Finding(
            "Python",
            "good" if fine else "bad",
            f"{platform.python_version()}, {platform.system()} {platform.machine()}",
        )
    ]


def _packages() -> list[Finding]:
    found = []
    for name in _NEEDED:
        try:
            found.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            return [Finding("packages", "bad", f"{name} is missing: pip install trueup brings it")]
    return [Finding("packages", "good", ", ".join(found))]


def _extras() -> list[Finding]:
    return [
        Finding("extra", "good", f"{module}: {purpose}") if importlib.util.find_spec(module) is not None
        else Finding("extra", "mind", f"{module} is not here ({purpose}): pip install 'trueup[{extra}]'")
        for module, (extra, purpose) in _EXTRAS.items()
    ]  # fmt: skip


def _threads() -> list[Finding]:
    asked = os.environ.get("OMP_NUM_THREADS", "")
    if asked and asked != "1":
        said = f"{cores()} cores, but OMP_NUM_THREADS is {asked}: small matrices are slower so, processes wait for each other"
        return [Finding("threads", "mind", f"{said}; unset it")]
    return [Finding("threads", "good", f"{cores()} cores; simulations use them all, matrices one each")]


def _yardstick() -> list[Finding]:
    """Steps of a humanoid's worth of hinges, in this process."""
    import mujoco

    shape = '<geom size=".02" fromto="0 0 0 .1 0 0" type="capsule" contype="0" conaffinity="0"/>'
    links = f'<body pos=".1 0 0"><joint axis="0 1 0" damping=".1"/>{shape}' * 20
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{links}{'</body>' * 20}</worldbody></mujoco>")
    data, began, wall = mujoco.MjData(model), time.process_time(), time.perf_counter()
    mujoco.mj_step(model, data, 20_000)
    took, passed = time.process_time() - began, time.perf_counter() - wall
    said = f"20 000 steps of 20 hinges in {took:.2f} s of one core ({_USUAL:g} s where the benchmarks were measured)"
    if passed > 1.5 * took:
        return [Finding("speed", "mind", f"{said}, but {passed:.2f} s by the clock: others use this machine too")]
    return [Finding("speed", "good" if took < 3 * _USUAL else "mind", said)]


def _rendering() -> list[Finding]:
    """Whether MuJoCo can draw; nothing in trueup's own reports needs it."""
    choices = {
        "glfw": "DISPLAY" in os.environ or "WAYLAND_DISPLAY" in os.environ,
        "egl": _library("EGL"),
        "osmesa": _library("OSMesa"),
    }
    there = [name for name, can in choices.items() if can]
    if there:
        return [
            Finding("rendering", "good", f"MUJOCO_GL may be: {', '.join(there)} (films of motions; reports need none)")
        ]
    return [
        Finding("rendering", "mind", "no screen, EGL or OSMesa: MuJoCo cannot draw here; reports need none of them")
    ]


def _library(name: str) -> bool:
    from ctypes.util import find_library

    return find_library(name) is not None


def _browser() -> list[Finding]:
    path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "firefox"))), None)
    return [
        Finding(
            "browser",
            "good" if path else "mind",
            path or "none found here: open report.html on another machine, it is one file",
        )
    ]
