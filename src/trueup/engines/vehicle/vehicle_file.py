# SPDX-License-Identifier: Apache-2.0
"""A vehicle as a TOML file, which a person writes with two lines and a calibration with all values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from trueup import files
from trueup.engines.vehicle.vehicle import DRIVES, PURSUED, TURNED, Vehicle
from trueup.errors import ModelError
from trueup.formats.aside import write_aside
from trueup.formats.keys import quoted
from trueup.tracking.wheels import Wheels
from trueup.typed_toml import build

_DRIVES = {"throttle": "throttle", "speed": PURSUED, "turn": TURNED}
_COMMANDS = {
    "throttle": "throttle and steering, without unit",
    "speed": "speed in m/s and steering in rad",
    "turn": "speed in m/s and turn rate in rad/s, of two driven wheels",
}
_AS_LOGGED = "speed and steering as in the logs, beyond middle and over full"
_SHARES = "mean and difference of what a left and a right wheel are told, as shares of the full command"
_EARLIER = {"steering_play": ("steering_slack", 2.0), "steering_rate": ("steering_rate_limit", 1.0)}
"""Quantities as files named them before: the name that they have now, and the factor to its value."""


_MOVED = frozenset({"pose_ahead", "steering_bend"})
"""Quantities of vehicles on tyres in whose place others are now, see `_on_tyres`."""


@dataclass(frozen=True)
class _VehicleFile:
    wheelbase: float | None = None
    name: str | None = None
    drive: Literal["throttle", "speed", "turn"] | None = None
    driven: Literal["", "rear", "front"] = ""
    enabled_by: str = ""
    middle: tuple[float, float] = (0.0, 0.0)
    full: tuple[float, float] | None = None
    values: Mapping[str, float] = field(default_factory=dict)
    track: float | None = None
    wheel_radius: float = 0.0
    counts_per_turn: float = 0.0


def read_vehicle(path: str | Path) -> Vehicle:
    """The vehicle in a TOML file: [vehicle] with wheelbase in m, and [vehicle.values] where some are known.

    A robot on two driven wheels has their `track` in m in place of the wheelbase, and may have `wheel_radius` in m and an
    encoder's `counts_per_turn` of a wheel.

    Raises ModelError, naming file and key, for what is missing, unknown or of the wrong kind.
    """
    where = Path(path)
    data = files.toml(where, ModelError)
    if not isinstance(data.get("vehicle"), Mapping):
        raise ModelError(
            f"vehicle '{where}' has no table [vehicle]; it needs at least: [vehicle] wheelbase = 0.17, or of a robot "
            "on two driven wheels track = 0.23 (m between them)"
        )
    given = build(_VehicleFile, data["vehicle"], f"vehicle '{where}', [vehicle]", ModelError)
    named = dict(_current(name, value) for name, value in given.values.items())
    wheels = None if given.track is None else Wheels(given.track, given.wheel_radius, given.counts_per_turn)
    wheelbase = _over(given, f"vehicle '{where}', [vehicle]")
    drive = (
        _DRIVES[given.drive or "turn"]
        if given.drive is not None or wheels is not None
        else next((d for d in _DRIVES.values() if set(named) - _MOVED <= {q.name for q in DRIVES[d]}), "throttle")
    )
    known = named if drive == TURNED else _on_tyres(named, drive, wheelbase)
    return Vehicle(
        name=where.stem if given.name is None else given.name, wheelbase=wheelbase, values=known, drive=drive,
        wheels=wheels, declared=given.drive is not None or wheels is not None, enabled_by=given.enabled_by,
        driven=given.driven,
        middle=given.middle, full=given.full,
    )  # fmt: skip


def write_vehicle(vehicle: Vehicle, path: Path, notes: Mapping[str, str] | None = None) -> None:
    """Writes a vehicle with all that is known of it; `notes` by quantity stand beside its value. Raises OutputError."""
    said = next(name for name, drive in _DRIVES.items() if drive == vehicle.drive)
    lines = [
        "[vehicle]",
        f"name = {quoted(vehicle.name)}",
        *_sizes(vehicle),
        f'drive = "{said}"  # commands: {_commands(vehicle, said)}',
    ]
    if vehicle.driven:
        lines.append(f'driven = "{vehicle.driven}"  # the axle whose speed is commanded; the front one is steered')
    if vehicle.enabled_by:
        lines.append(f"enabled_by = {quoted(vehicle.enabled_by)}")
    if vehicle.full:
        lines.append(f"middle = {list(vehicle.middle)}  # recorded drive and steering that stand for zero")
        lines.append(f"full = {list(vehicle.full)}  # how far beyond they stand for one")
    lines += ["", "[vehicle.values]"]
    for name, value in vehicle.values.items():
        q, note = vehicle.quantity(name), (notes or {}).get(name, "")
        about = f"{q.unit + ', ' if q.unit else ''}{q.about}"
        lines.append(f"{name} = {float(value)!r}  # {about}{'; ' + note if note else ''}")
    write_aside("\n".join(lines) + "\n", path)


def _commands(vehicle: Vehicle, drive: str) -> str:
    """What commands a vehicle, and in which units as far as these are known."""
    if vehicle.told_shares:
        return _SHARES
    return _AS_LOGGED if drive == "speed" and vehicle.full and not vehicle.in_si else _COMMANDS[drive]


def _over(given: _VehicleFile, where: str) -> float:
    """The length in m over which the vehicle turns. Raises ModelError where the file says none, or both."""
    length = given.wheelbase if given.track is None else given.track
    if length is None:
        raise ModelError(
            f"{where}: 'wheelbase' is missing (m between the axles), or 'track' (m between two driven wheels)"
        )
    if given.track is not None and (given.wheelbase is not None or given.drive not in (None, "turn")):
        other = "'wheelbase'" if given.wheelbase is not None else f"drive = '{given.drive}'"
        raise ModelError(
            f"{where}: 'track' is of a robot that two driven wheels turn, {other} of a car; keep one of them"
        )
    if given.track is None and (given.wheel_radius or given.counts_per_turn):
        raise ModelError(
            f"{where}: 'wheel_radius' and 'counts_per_turn' are of two driven wheels; add their 'track' in m"
        )
    return length


def _sizes(vehicle: Vehicle) -> list[str]:
    if vehicle.wheels is None:
        return [f"wheelbase = {vehicle.wheelbase!r}  # m"]
    sizes = {
        "track": (vehicle.wheels.track, "m, between the two driven wheels"),
        "wheel_radius": (vehicle.wheels.radius, "m"),
        "counts_per_turn": (vehicle.wheels.counts_per_turn, "of an encoder, for a turn of a wheel"),
    }
    return [f"{name} = {value!r}  # {about}" for name, (value, about) in sizes.items() if value]


def _on_tyres(named: Mapping[str, float], drive: str, wheelbase: float) -> dict[str, float]:
    """Values of a vehicle on tyres whose file may be of before the tracked point was told from the rear axle, and angles of
    a car by throttle were angles: they were tangents, which are met at a full command.
    """
    known = {q.name: q.absent for q in DRIVES[drive]} | dict(named)
    now = {n: v for n, v in named.items() if n not in _MOVED}
    if "pose_ahead" in named:
        now["pose_at"] = named["pose_ahead"] / wheelbase + known["weight_in_front"]
    if "steering_bend" in named:
        full = 0.5 * (known["steering_left"] + known["steering_right"])
        left = 1.0 - named["steering_bend"]
        now["steering_falloff"] = 1.0 - (math.atan(full * left) / full if drive == "throttle" else left)
    return now


def _current(name: str, value: float) -> tuple[str, float]:
    new, factor = _EARLIER.get(name, (name, 1.0))
    return new, factor * value
