# SPDX-License-Identifier: Apache-2.0
"""What each stage of the search earns: several families calibrated with all stages, and with each one left out in turn.

With `--windows`: a leg and an arm replayed in windows of several lengths, and by how much that changes the estimates.
"""

from __future__ import annotations

import argparse
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import leg_problem
import mujoco
import numpy as np
import servo_problem
import so101 as arm_logs
from arm_problem import make_problem
from calibrate_arm import OPTIONS, declared
from numpy.typing import NDArray
from results import result
from slow_wheels import asked, turned
from starts import bad_start

from trueup.articulated.declarations import Declaration, declare
from trueup.calibration import Calibration, pooled_rmse
from trueup.discrepancies.discrepancy import Discrepancy
from trueup.discrepancies.rigid import RigidlyAligned
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.simulator import Simulator
from trueup.engines.vehicle import BETAS, BicycleSimulator, Vehicle, vehicle_space
from trueup.loop.calibrate import Options, calibrate
from trueup.loop.fit import STAGES
from trueup.loop.prepare import Preparation, prepare
from trueup.recording import Channel, Recording
from trueup.search.least_squares import LeastSquares
from trueup.tracking.windows import windows
from trueup.trial import Observed, Trial

Array = NDArray[np.float64]

TURNING = ("steering_*", "relaxation", "understeer", "grip", "friction_limit", "pose_*", "drive", "friction")
FACTORS = (0.3, 0.5, 1.0, 2.0)  # of the length of windows
_LOSS, _CPU = 0.01, 0.1  # shares of which a stage must earn one on some family
_DRIVEN = {
    "position": (("x", "y"), "m"), "heading": (("heading",), "rad"), "speed": (("speed",), "m/s"),
    "yaw_rate": (("yaw_rate",), "rad/s"),
}  # fmt: skip
NEEDED = ("all, full step", "selection")
SOLVERS: Mapping[str, Callable[..., LeastSquares]] = {
    "slopes used again": partial(LeastSquares, reuse=0),
    "steps side by side": partial(LeastSquares, ladder=(1.0,)),
    "steps uphill": partial(LeastSquares, climbs=0),
}
"""Parts of the least squares, and how it is without each."""


@dataclass(frozen=True)
class Case:
    """One problem with its truth."""

    simulator: Simulator
    recordings: tuple[Recording, ...]
    truth: Mapping[str, float]
    options: Options = field(default_factory=partial(Options, cross_validate=False))
    discrepancy: Discrepancy | None = None
    ready: Preparation | None = None
    """Calibrates in the way of its family, where that has one of its own."""

    def solved(self, options: Options) -> Calibration:
        """The calibration, in the way of its family."""
        if self.ready is None:
            return calibrate(self.simulator, self.recordings, options=options, discrepancy=self.discrepancy)
        return self.ready.calibrate(options)

    def judged(self, done: Calibration) -> tuple[float, int]:
        """The median error of estimates in percent of the truth, and how many of their intervals hold it.

        Where no truth is known the error is what was left out, in percent of what it was before.
        """
        found = {e.name: e for e in done.estimates}
        if not self.truth:
            left_out = done.held_out()
            return 100.0 * pooled_rmse(left_out, after=True) / pooled_rmse(left_out, after=False), 0
        errors = [abs(found[n].value / t - 1.0) for n, t in self.truth.items()]
        return 100.0 * float(np.median(errors)), sum(found[n].low <= t <= found[n].high for n, t in self.truth.items())


def leg(seed: int, folder: Path) -> Case:
    """Contacts: the leg of `leg.py`."""
    rng = np.random.default_rng([seed, 2026])
    truth = leg_problem.Truth.drawn(rng)
    known = {"floor.contact_friction": truth.friction, "controller.kp": truth.kp, "controller.kd": truth.kd}
    return Case(leg_problem.simulator(folder), tuple(leg_problem.recordings(truth, rng)), known)


def servos(seed: int, folder: Path) -> Case:
    """Two joints with servos whose gains, friction, inertia and delay are to be found."""
    rng = np.random.default_rng([seed, 2026])
    truth = servo_problem.drawn(rng)
    made = servo_problem.simulator(folder)
    return Case(made, tuple(servo_problem.recordings(truth, rng)), servo_problem.known(truth))


def far(seed: int, folder: Path) -> Case:
    """The 30-parameter arm from one of the starts of `starts.py`."""
    problem = make_problem(seed % 4, folder=folder)
    simulator = declared(problem, bad_start(problem, np.random.default_rng(seed)))
    names = [p.name for p in simulator.parameters.parameters]
    return Case(simulator, problem.training, dict(zip(names, problem.truth, strict=True)), options=OPTIONS)


def vehicle(seed: int, folder: Path) -> Case:
    """Rate limits and delays make a loss of stairs: a minute of jumps and waves of a bicycle, in windows of 8 s."""
    bare = Vehicle("bare", wheelbase=0.55, max_steering=0.698)
    made = BicycleSimulator(bare, vehicle_space(bare, BETAS))
    rng = np.random.default_rng(seed)
    truth = rng.uniform([0.05, 0.05, 0.3, 0.45, 0.6], [0.4, 0.4, 0.6, 0.6, 1.0])
    time = np.arange(3001) / 50.0
    steering = 0.45 * np.sin(0.9 * time) + 0.2 * np.sign(np.sin(0.37 * time))
    speed = 0.55 + 0.25 * np.sign(np.sin(0.21 * time)) + 0.1 * np.sin(1.1 * time)
    command = Channel("command", ("speed", "steering"), "", time, np.stack([speed, steering], axis=1))
    begin = {"speed": Channel("speed", ("speed",), "m/s", np.zeros(1), np.full((1, 1), 0.8))}
    observed = {name: Observed(labels, unit, time) for name, (labels, unit) in _DRIVEN.items()}
    clean = made.rollout([Trial("drive", 0.0, 60.0, command, observed, begin)], truth[None])[0].recording()
    noisy = {
        name: c if name == "command" else c.replace(values=c.values + 0.003 * rng.standard_normal(c.values.shape))
        for name, c in clean.channels.items()
    }
    pieces = tuple(windows(Recording("drive", noisy), 8.0))
    options = Options(channels=tuple(_DRIVEN), cross_validate=False)
    return Case(made, pieces, dict(zip(made.parameters.names, truth, strict=True)), options=options,
                discrepancy=RigidlyAligned.estimated(pieces, tuple(_DRIVEN)))  # fmt: skip


_JUMPING = """<mujoco><option timestep="{step}"/><worldbody><body><joint name="j" axis="0 1 0" damping=".3" {armature}/>
<geom size=".05" mass="1" pos="0 0 -.2"/></body></worldbody>
<actuator><position name="m" joint="j" {drive}/></actuator></mujoco>"""


def _commanded(
    model: mujoco.MjModel, time: Array, wanted: Array, noise: float, rng: np.random.Generator, settle: int = 0
) -> Recording:
    """What a servo's encoder at its outlet sees (rad, all joints of its one axis added) while it is told to be at `wanted`.

    It comes to rest at the first of them within `settle` steps.
    """
    data, seen = mujoco.MjData(model), []
    data.ctrl[0] = wanted[0]
    mujoco.mj_step(model, data, settle)
    for target in wanted:
        seen.append(data.qpos.sum())
        data.ctrl[0] = target
        mujoco.mj_step(model, data, round((time[1] - time[0]) / model.opt.timestep))
    measured = np.array(seen) + rng.normal(0.0, noise, len(time))
    both = (("position", measured), ("command", wanted))
    return Recording("servo", {n: Channel(n, ("j",), "rad", time, v[:, None]) for n, v in both})


def jumps(seed: int, folder: Path) -> Case:
    """A pendulum's servo that meets its force limit at each jump of the command; the truth steps by 0.5 ms, the file by 2."""
    rng = np.random.default_rng(seed)
    kp, kv, limit = (float(x) for x in rng.uniform([20.0, 0.6, 2.5], [60.0, 2.0, 8.0]))
    drive = f'kp="{kp}" kv="{kv}" forcerange="-{limit} {limit}"'
    model = mujoco.MjModel.from_xml_string(_JUMPING.format(step=5e-4, armature='armature=".01"', drive=drive))
    time = np.arange(0.0, 6.0, 0.01)
    log = _commanded(model, time, 0.5 * np.sign(np.sin(2.0 * time)) * (time > 0.5), 1e-3, rng)
    file = folder / "servo.xml"
    file.write_text(_JUMPING.format(step=2e-3, armature="", drive='kp="20"'))
    ready = prepare(file, [log])
    return Case(ready.simulator, tuple(ready.recordings), {"m.kp": kp, "m.force_limit": limit})


_LOOSE = """<mujoco><option timestep="{step}" integrator="implicitfast"/><worldbody><body>
<joint name="j" axis="0 1 0" damping="{damping}" frictionloss=".05" armature=".01"/>
<inertial pos="0 0 -.1" mass=".5" diaginertia=".003 .003 .0006"/>{play}</body></worldbody>
<actuator><position name="m" joint="j" kp="{kp}"/></actuator></mujoco>"""
_PLAY = """<joint name="play" axis="0 1 0" limited="true" range="-{0} {0}" armature="2e-4" damping=".01"
solreflimit=".006 1" solimplimit=".95 .99 .0005"/>"""


def play(seed: int, folder: Path) -> Case:
    """A servo behind a gear with play, seen at its outlet: the truth steps by 0.25 ms, the simulator by 1."""
    rng = np.random.default_rng(seed)
    kp, damping, backlash = (float(x) for x in rng.uniform([15.0, 0.1, 0.008], [40.0, 0.4, 0.03]))
    truth = _LOOSE.format(step=2.5e-4, damping=damping, kp=kp, play=_PLAY.format(0.5 * backlash))
    model = mujoco.MjModel.from_xml_string(truth)
    time = np.arange(0.0, 5.0, 0.005)
    waves = 0.25 * np.sin(2 * np.pi * rng.uniform(0.3, 3.0, 5) * time[:, None] + rng.uniform(0.0, 6.0, 5)).sum(axis=1)
    wanted = waves + rng.uniform(-0.5, 0.5, 5)[time.astype(int)]
    log = _commanded(model, time, wanted, 2e-4, rng, settle=4000)
    file = folder / "gear.xml"
    file.write_text(_LOOSE.format(step=1e-3, damping=0.2, kp=15.0, play=""))
    lines = [Declaration(n, ("j",)) for n in ("backlash", "damping", "friction")] + [Declaration("kp", ("m",))]
    file_model = load(file)
    space, quantities = declare(file_model, lines, {})
    known = {"j.backlash": backlash, "j.damping": damping, "m.kp": kp}
    return Case(MujocoSimulator(file_model, space, quantities, step=1e-3), (log,), known)


def slow_wheels(seed: int, folder: Path) -> Case:
    """A car whose wheels turn no faster than a limit that the search's start does not meet, so that no slope leads to it."""
    rng, step, speed, wheelbase = np.random.default_rng(seed), 0.02, 1.2, 0.2
    rate = float(rng.uniform(0.35, 0.8))
    time = step * np.arange(4000.0)
    asked = 0.6 * np.sign(np.sin(rng.uniform(0.7, 1.1) * time)) * np.abs(np.sin(rng.uniform(0.2, 0.3) * time))
    wheel = np.zeros(len(time))
    for k in range(1, len(time)):
        wheel[k] = wheel[k - 1] + np.clip(asked[k] - wheel[k - 1], -step * rate, step * rate)
    heading = np.cumsum(step * speed / wheelbase * np.tan(0.4 * wheel))
    way = np.cumsum(step * speed * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    log = Recording("drive", {
        "command": Channel("command", ("throttle", "steering"), "", time, np.stack([0.0 * time + 0.3, asked], axis=1)),
        "position": Channel("position", ("x", "y"), "m", time, way + rng.normal(0.0, 5e-4, way.shape)),
        "heading": Channel("heading", ("heading",), "rad", time, heading[:, None]),
    })  # fmt: skip
    file = folder / "car.toml"
    file.write_text(f"[vehicle]\nwheelbase = {wheelbase}\n")
    ready = prepare(file, [log])
    return Case(ready.simulator, tuple(ready.recordings), {"steering_rate_limit": rate}, ready=ready)


def short_turns(seed: int, folder: Path) -> Case:
    """Twelve seconds of a car whose wheels turn slowly, as `slow_wheels` drives it: first seconds do not show that."""
    file = folder / "car.toml"
    file.write_text(
        "[vehicle]\nwheelbase = 0.2\n[vehicle.values]\npush_lasts = 0.0\ntrim_lasts = 0.0\nspeed_kept = 0.0\n"
    )
    ready = prepare(file, [turned(asked(0.0, 12.0), 0.5, 0.0, np.random.default_rng(seed))]).only(TURNING)
    return Case(ready.simulator, tuple(ready.recordings), {"steering_rate_limit": 0.5}, ready=ready)


def so101(seed: int, folder: Path) -> Case:
    """Eleven minutes of a real geared arm, whose joints are searched one by one. Each seed is the same."""
    fitted, left_out = (arm_logs.recordings(n) for n in (arm_logs.TRAINING, arm_logs.HELD_OUT))
    ready = prepare(arm_logs.folder() / "model" / "so101_new_calib.xml", fitted, left_out)
    return Case(ready.simulator, tuple(ready.recordings), {}, ready=ready)


FAMILIES: Mapping[str, Callable[[int, Path], Case]] = {
    "servos": servos, "leg": leg, "far starts": far, "vehicle": vehicle, "jumps": jumps, "play": play,
    "slow wheels": slow_wheels, "short turns": short_turns, "so101": so101,
}  # fmt: skip
MEASURED = ("so101",)
"""Families of real recordings, which are asked for by name."""


@dataclass(frozen=True)
class Row:
    """What came of one family without one stage, over its seeds."""

    loss: Array
    error: Array
    evaluations: Array
    cpu: Array
    held: Array
    """How many intervals hold the truth,"""
    asked: Array
    """and of how many."""

    def against(self, whole: Row) -> tuple[float, float, float]:
        """Shares by which leaving the stage out changed loss (worst seed), evaluations and CPU seconds."""
        return (
            float(np.max(self.loss / whole.loss)) - 1.0,
            float(self.evaluations.sum() / whole.evaluations.sum()) - 1.0,
            float(self.cpu.sum() / whole.cpu.sum()) - 1.0,
        )


def measured(family: str, seeds: int, without: str) -> Row:
    """One family with a stage left out, or with all for ''."""
    rows = []
    for seed in range(seeds):
        with tempfile.TemporaryDirectory() as folder:
            case = FAMILIES[family](seed, Path(folder))
            stages = tuple(s for s in STAGES if s.name != without)
            solver = SOLVERS.get(without, LeastSquares)
            done = case.solved(replace(case.options, stages=stages, solver=solver))
            error, held = case.judged(done)
        # The last of the trace is the loss of what is reported.
        rows.append((done.trace[-1].loss, error, done.evaluations, done.cpu_seconds, held, len(case.truth)))
    return Row(*np.array(rows, dtype=np.float64).T)


def windowed(family: str, seeds: int) -> None:
    """Prints how far estimates of other windows are from those of the chosen one, and the RESULT line of a family.

    In units of what the intervals of both leave open: half their widths, squared and added (the difference of two
    estimates is no surer than that). Where whole recordings are chosen the longest of them is the length.
    """
    changes = []
    for seed in range(seeds):
        with tempfile.TemporaryDirectory() as folder:
            case = FAMILIES[family](seed, Path(folder))
            longest = max(float(r.time[-1] - r.time[0]) for r in case.recordings)
            lengths = {factor: factor * longest if factor < 1.0 else np.inf for factor in FACTORS}
            done = {w: case.solved(replace(case.options, windows=w)).estimates for w in set(lengths.values())}
        found = {factor: done[length] for factor, length in lengths.items()}
        for factor in FACTORS:
            pairs = [(a, b) for a, b in zip(found[factor], found[1.0], strict=True) if a.fitted and b.fitted]
            shares = [abs(a.value - b.value) / (0.5 * np.hypot(a.high - a.low, b.high - b.low)) for a, b in pairs]
            errors = [100.0 * abs(a.value / case.truth[a.name] - 1.0) for a, _ in pairs if a.name in case.truth]
            changes += shares
            print(f"{family:8s} {seed:3d}  windows x {factor:3.1f}  change / interval: median {np.median(shares):5.2f}, "
                  f"largest {max(shares):5.2f}; largest error {max(errors):6.2f} %", flush=True)  # fmt: skip
    named = f"largest, windows of 0.3 to 2, {seeds} robots"
    result(f"windows_change_over_interval_{family}", float(max(changes)), named, 1.0)


def main() -> None:
    """Prints a table, one line a family and stage, and the RESULT lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one seed of the servos and the vehicle")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--families", nargs="*", choices=FAMILIES, default=[f for f in FAMILIES if f not in MEASURED])
    names = list(dict.fromkeys(s.name for s in STAGES if s.name not in NEEDED))
    parser.add_argument("--stages", nargs="*", choices=[*names, *SOLVERS], default=[*names, *SOLVERS])
    parser.add_argument("--windows", action="store_true", help="windows of several lengths in place of stages")
    options = parser.parse_args()
    if options.windows:
        for family in ("leg", "servos"):
            windowed(family, 1 if options.quick else options.seeds)
        return
    families, seeds = (["servos", "vehicle"], 1) if options.quick else (options.families, options.seeds)
    print(
        f"{'family':12s} {'without':20s} {'loss':>9s} {'error %':>9s} {'evaluations':>12s} {'CPU s':>8s} {'intervals':>10s}"
    )
    earned = dict.fromkeys(options.stages, (0.0, 0.0))
    for family in families:
        whole = measured(family, seeds, "")
        _line(family, "nothing", whole, whole)
        for name in options.stages:
            row = measured(family, seeds, name)
            _line(family, name, row, whole)
            loss, _, cpu = row.against(whole)
            earned[name] = max(earned[name][0], loss), max(earned[name][1], cpu)
    for name, (loss, cpu) in earned.items():
        result(f"without_{name.replace(', ', '_').replace(' ', '_')}", 100.0 * max(loss / _LOSS, cpu / _CPU),
               "% of what a stage must earn", 100.0, at_most=False)  # fmt: skip


def _line(family: str, name: str, row: Row, whole: Row) -> None:
    loss, evaluations, cpu = row.against(whole)
    print(f"{family:12s} {name:20s} {100 * loss:+8.2f}% {np.mean(row.error):9.2f} {100 * evaluations:+11.0f}% "
          f"{100 * cpu:+7.0f}% {f'{row.held.sum():.0f} of {row.asked.sum():.0f}':>10s}   "
          f"{np.sum(row.evaluations):.0f} evaluations, {np.sum(row.cpu):.1f} s",
          flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
