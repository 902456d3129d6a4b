# SPDX-License-Identifier: Apache-2.0
"""Drives of 3 s commanded by speed and steering angle: where they end, predicted from their first state.

Simulated cars of another structure than trueup's (`driven_cars`), each logged as another program writes it, and a real 1:10
car (folder `jetracer` of TRUEUP_DATA, or of ../shared/data; left out without it), whose wheel speed stands for a commanded
one and whose steering share times 0.4 for an angle. Every second simulated drive, or each whole real one in turn, is not
fitted. The peer is a kinematic bicycle with wheelbase, gain and offset of the steering, gain of the speed, a lag and a delay
of both, fitted by least squares (plain and robust, wheels at first as commanded or as the turn rate shows: whatever is best
on the drives that it is fitted to) to where the same drives are after half their time and at their end. Both start from the
same state, which the first quarter of a second shows.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from driven_cars import CARS, cut, driven, written
from jetracer import drives as jetracer_drives
from numpy.typing import NDArray
from results import result
from scipy.optimize import OptimizeResult, least_squares

from trueup import formats
from trueup.engines.vehicle import VehicleSimulator
from trueup.engines.vehicle.prediction import horizons_for, prediction_errors
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording
from trueup.tracking.past import first_state
from trueup.trial import Trial

Array = NDArray[np.float64]

_DT = 0.01
_LEAD = 100  # steps of commands before the start
_LENGTH = 3.0
_WHEELBASE = 0.1735  # of the real car
_FULL = 0.4  # rad: its steering angle at full command, roughly, as a user would declare it


@dataclass(frozen=True, eq=False)
class Drives:
    """What the peer is told of n drives: start (n, 5), commands (T, n, 2), steps (n,), places halfway and at the end."""

    start: Array
    commands: Array
    steps: NDArray[np.int64]
    halfway: Array
    end: Array

    @classmethod
    def of(cls, simulator: VehicleSimulator, recordings: list[Recording], reach: float) -> Drives:
        """Of prepared recordings, from their first state on."""
        parts = []
        for r in recordings:
            past = simulator.past(Trial.of(r, simulator.observable(r)))
            for k in first_state(past, reach):
                begun, steps = past.begin + past.step * k, round(reach / _DT)
                told = r.channel("command").at(begun + _DT * np.arange(-_LEAD, steps + 2), hold=True)
                position = r.channel("position")
                good = np.isfinite(position.values).all(axis=1)
                half, end = (
                    [np.interp(begun + t, position.time[good], c) for c in position.values[good].T]
                    for t in (reach / 2.0, reach)
                )
                parts.append((past.seen[k], told, steps, half, end))
        start, told, steps, half, end = zip(*parts, strict=True)
        return cls(np.array(start), np.stack(told, axis=1), np.array(steps), np.array(half), np.array(end))


class Kinematic:
    """The peer on drives: values are wheelbase, steering gain and offset, speed gain, lags and delays of both.

    A turn rate that is commanded is one, not an angle: two driven wheels have no wheelbase.
    """

    def __init__(self, drives: Drives, wheelbase: float, *, turns: bool) -> None:
        self._d, self._wheelbase, self._turns = drives, wheelbase, turns

    def error(self, values: Array, seen: bool) -> Array:
        """(2, n, 2) predicted minus tracked position, halfway and at the end; `seen`: wheels start as the turn rate shows."""
        base, gain, offset, scale, slow, lag, late, delay = values
        d = self._d
        x, y, heading, speed, turning = d.start.T.copy()

        def told(column: int, at: float) -> Array:
            i = int(np.clip(np.floor(at), 0, len(d.commands) - 2))
            part = float(np.clip(at - i, 0.0, 1.0))
            return (1.0 - part) * d.commands[i, :, column] + part * d.commands[i + 1, :, column]

        wheel = gain * told(1, _LEAD - late / _DT) + offset
        if seen:
            wheel = turning if self._turns else np.arctan(base * turning / np.maximum(speed, 0.1))
        shares = [1.0 - np.exp(-_DT / max(v, 1e-4)) for v in (slow, lag)]
        places = []
        last = int(d.steps[0])
        for k in range(last + 1):
            if k in (last // 2, last):
                places.append(np.stack([x, y], axis=1))
            wheel = wheel + shares[0] * (gain * told(1, k + _LEAD - late / _DT) + offset - wheel)
            speed = speed + shares[1] * (scale * told(0, k + _LEAD - delay / _DT) - speed)
            turn = wheel if self._turns else speed * np.tan(np.clip(wheel, -1.3, 1.3)) / base
            x, y = (
                x + _DT * speed * np.cos(heading + 0.5 * _DT * turn),
                y + _DT * speed * np.sin(heading + 0.5 * _DT * turn),
            )
            heading = heading + _DT * turn
        return np.stack(places) - np.stack([d.halfway, d.end])

    def fitted(self) -> tuple[Array, bool]:
        """The values, and how wheels start, that predict best where these drives end."""
        L = self._wheelbase
        bounds = ([0.5 * L, 0.3, -0.3, 0.3, 0.0, 0.0, 0.0, 0.0], [2.0 * L, 3.0, 0.3, 3.0, 1.0, 3.0, 0.5, 0.5])

        def one(seen: bool, loss: str, lag: float) -> OptimizeResult:
            start, scale = [L, 1.0, 0.0, 1.0, 0.1, lag, 0.05, 0.05], [L, 1.0, 0.1, 1.0, 0.1, 0.3, 0.1, 0.1]
            return least_squares(lambda v: self.error(v, seen).ravel(), start, bounds=bounds, diff_step=1e-3, x_scale=scale,
                                 loss=loss, f_scale=0.1, max_nfev=40)  # fmt: skip

        ways = [(seen, one(seen, *how).x) for seen in (False, True) for how in (("linear", 0.1), ("soft_l1", 0.5))]
        seen, values = min(ways, key=lambda way: float(np.linalg.norm(self.error(way[1], way[0])[1], axis=1).mean()))
        return values, seen


def compared(
    name: str, wheelbase: float, fitted: list[Recording], others: list[Recording], folder: Path
) -> tuple[Array, Array]:
    """(n,) distances in m at the end of drives not fitted, ours and the peer's; prints a row."""
    car = folder / "car.toml"
    car.write_text(f"[vehicle]\nwheelbase = {wheelbase}\n", encoding="utf-8")
    began = time.process_time()
    ready = prepare(car, fitted)
    simulator, found = ready.simulator, ready.calibrate()
    assert isinstance(simulator, VehicleSimulator)
    spent = time.process_time() - began
    clean, unseen = ([simulator.prepared(r) for r in rs] for rs in (fitted, others))
    reach = horizons_for(simulator, unseen, (1.0, _LENGTH))[-1]
    mine = np.concatenate([prediction_errors(simulator, found.values, r, (reach,))[:, 0] for r in unseen])
    plain, declared = mine[np.isfinite(mine)], simulator.shipped()
    start = np.concatenate([prediction_errors(declared, np.zeros(0), r, (reach,))[:, 0] for r in unseen])
    turns = simulator.vehicle.steered_over == 0.0
    values, seen = Kinematic(Drives.of(simulator, clean, reach), wheelbase, turns=turns).fitted()
    off = Kinematic(Drives.of(simulator, unseen, reach), wheelbase, turns=turns).error(values, seen)
    peer = np.linalg.norm(off[1], axis=1)
    cells = (start[np.isfinite(start)].mean(), plain.mean(), np.median(plain), peer.mean(), np.median(peer))
    shown = "".join(f"{1e3 * cell:9.0f}" for cell in cells)
    print(f"{name:28s}{len(plain):5d}{reach:7.1f} s{shown}{plain.mean() / peer.mean():8.2f}{spent:8.1f} s", flush=True)
    return plain, peer


def simulated(number: int, folder: Path, runs: int) -> tuple[Array, Array]:
    """One of CARS, through log files."""
    car, rng = CARS[number], np.random.default_rng([number, 1])
    pieces = [piece for _ in range(runs) for piece in cut(driven(car, 24.0, rng), _LENGTH, rng)]
    logs = [formats.read(written(car, piece, folder / f"drive_{k:02d}.csv"))[0] for k, piece in enumerate(pieces)]
    return compared(car.name, car.wheelbase, logs[::2], logs[1::2], folder)


def real(root: Path) -> list[list[Recording]]:
    """The real drives, each cut into pieces of 3 s in which it drives all the time."""
    found = []
    for whole in jetracer_drives(root):
        wheels = whole.channel("speed")
        steering = whole.channel("command").select(("steering",)).at(wheels.time, hold=True)
        told = np.stack([wheels.values[:, 0], _FULL * steering[:, 0]], axis=1)
        command = Channel("command", ("speed", "steering"), "", wheels.time, told, ("m/s", "rad"))
        kept = whole.replace(channels={"command": command, **{n: whole.channel(n) for n in ("position", "heading")}})
        starts = np.arange(whole.start + 1.0, whole.start + whole.duration - _LENGTH, _LENGTH).tolist()
        pieces = [kept.slice(t, t + _LENGTH).replace(name=f"{whole.name} {t:.0f} s") for t in starts]
        found.append([p for p in pieces if p.channel("command").values[:, 0].min() > 0.3 and _tracked(p)])
    return found


def _tracked(piece: Recording) -> bool:
    """Whether the tracker did not lose the car: what it mistook for it is no drive's end."""
    steps = np.linalg.norm(np.diff(piece.channel("position").values, axis=0), axis=1)
    return bool(np.nanmax(steps) < 0.1)


def main() -> None:
    """Prints a row for each car and the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two simulated cars and one real drive left out")
    options = parser.parse_args()
    root = Path(os.environ.get("TRUEUP_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")) / "jetracer"
    print("end of drives not fitted, mm    n    after declared     ours   median     peer   median   ratio   its CPU")
    ratios, ours, peers = [], [], []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for number in (0, 1) if options.quick else range(len(CARS)):
            mine, peer = simulated(number, folder, 4)
            ratios.append(mine.mean() / peer.mean())
        whole = real(root) if root.is_dir() else []
        for k in range(1 if options.quick else len(whole)) if whole else ():
            rest = [p for j, pieces in enumerate(whole) if j != k for p in pieces]
            mine, peer = compared(f"real, {whole[k][0].name[:20]}", _WHEELBASE, rest, whole[k], folder)
            ours.append(mine)
            peers.append(peer)
    if ours:
        ratios.append(float(np.concatenate(ours).mean() / np.concatenate(peers).mean()))
        result("short_real_drives", float(np.concatenate(ours).mean()), "m", 0.5, peer="fitted kinematic bicycle",
               peer_value=float(np.concatenate(peers).mean()))  # fmt: skip
    result("short_drives_over_kinematic", float(np.exp(np.mean(np.log(ratios)))), "", 1.0)
    result("short_drives_over_kinematic_at_worst", float(max(ratios)), "", 1.0)


if __name__ == "__main__":
    main()
