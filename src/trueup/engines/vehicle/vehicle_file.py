# SPDX-License-Identifier: Apache-2.0
"""A vehicle as a TOML file, which a person writes with two lines and a calibration with all values."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from trueup import files
from trueup.engines.vehicle.vehicle import DRIVES, PURSUED, TURNED, Vehicle
from trueup.errors import ModelError
from trueup.formats.aside import written_aside

_KEYS = ("name", "wheelbase", "drive", "enabled_by", "middle", "full", "values")
_DRIVES = {"throttle": "throttle", "speed": PURSUED, "turn": TURNED}
_COMMANDS = {
    "throttle": "throttle and steering, without unit",
    "speed": "speed in m/s and steering in rad",
    "turn": "speed in m/s and turn rate in rad/s, of two driven wheels",
}
_EARLIER = {"steering_play": ("steering_slack", 2.0), "steering_rate": ("steering_rate_limit", 1.0)}
"""Quantities as files named them before: the name that they have now, and the factor to its value."""


def read_vehicle(path: str | Path) -> Vehicle:
    """The vehicle in a TOML file: [vehicle] with wheelbase in m, and [vehicle.values] where some are known.

    Raises ModelError, naming file and key, for what is missing, unknown or of the wrong kind.
    """
    where = Path(path)
    data = files.toml(where, ModelError)
    table = data.get("vehicle")
    if not isinstance(table, Mapping):
        raise ModelError(f"vehicle '{where}' has no table [vehicle]; it needs at least: [vehicle] wheelbase = 0.17")
    for key in table:
        if key not in _KEYS:
            raise ModelError(f"vehicle '{where}': unknown key '{key}' in [vehicle]; keys are: {', '.join(_KEYS)}")
    if table.get("drive", "throttle") not in tuple(_DRIVES):
        raise ModelError(f"vehicle '{where}': drive is {table['drive']!r}; choices are: {', '.join(_DRIVES)}")
    values = table.get("values", {})
    if not isinstance(values, Mapping):
        raise ModelError(f"vehicle '{where}': [vehicle.values] must be a table of numbers")
    known = dict(_current(name, _number(where, name, value)) for name, value in values.items())
    drive = (
        _DRIVES[table["drive"]]
        if "drive" in table
        else next((d for d in _DRIVES.values() if set(known) <= {q.name for q in DRIVES[d]}), "throttle")
    )
    return Vehicle(
        name=_text(where, table, "name", where.stem),
        wheelbase=_number(where, "wheelbase", table.get("wheelbase")),
        values=known,
        drive=drive,
        declared="drive" in table,
        enabled_by=_text(where, table, "enabled_by", ""),
        middle=_both(where, table, "middle") or (0.0, 0.0),
        full=_both(where, table, "full"),
    )


def write_vehicle(vehicle: Vehicle, path: Path, notes: Mapping[str, str] | None = None) -> None:
    """Writes a vehicle with all that is known of it; `notes` by quantity stand beside its value. Raises OutputError."""
    said = next(name for name, drive in _DRIVES.items() if drive == vehicle.drive)
    lines = [
        "[vehicle]",
        f'name = "{vehicle.name}"',
        f"wheelbase = {vehicle.wheelbase!r}  # m",
        f'drive = "{said}"  # commands: {_COMMANDS[said]}',
    ]
    if vehicle.enabled_by:
        lines.append(f'enabled_by = "{vehicle.enabled_by}"')
    if vehicle.full:
        lines.append(f"middle = {list(vehicle.middle)}  # recorded drive and steering that stand for zero")
        lines.append(f"full = {list(vehicle.full)}  # how far beyond they stand for one")
    lines += ["", "[vehicle.values]"]
    for name, value in vehicle.values.items():
        q, note = vehicle.quantity(name), (notes or {}).get(name, "")
        about = f"{q.unit + ', ' if q.unit else ''}{q.about}"
        lines.append(f"{name} = {float(value)!r}  # {about}{'; ' + note if note else ''}")
    with written_aside(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _current(name: str, value: float) -> tuple[str, float]:
    new, factor = _EARLIER.get(name, (name, 1.0))
    return new, factor * value


def _text(where: Path, table: Mapping[str, object], key: str, absent: str) -> str:
    value = table.get(key, absent)
    if not isinstance(value, str) or not value.replace(" ", "").isprintable() or '"' in value or "\\" in value:
        raise ModelError(f"vehicle '{where}': {key} is {value!r}; it must be a plain text")
    return value


def _both(where: Path, table: Mapping[str, object], key: str) -> tuple[float, float] | None:
    pair = table.get(key)
    if pair is None:
        return None
    if not isinstance(pair, list) or len(pair) != 2:
        raise ModelError(f"vehicle '{where}': {key} is {pair!r}; it must be two numbers, of throttle and steering")
    return _number(where, key, pair[0]), _number(where, key, pair[1])


def _number(where: Path, key: str, value: object) -> float:
    if value is None:
        raise ModelError(f"vehicle '{where}': {key} is missing; give it in m, from axle to axle")
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ModelError(f"vehicle '{where}': {key} is {value!r}; it must be a number")
    return float(value)
