# SPDX-License-Identifier: Apache-2.0
"""A cart that swings its pole up, with an engine, quantity, controller, task and robot of one's own, for `trueup run`.

    trueup run examples/cart_pole/campaign.toml --out out/cart_pole

Joints: `cart` in m, `pole` in rad from where it hangs. Commands: the motor's force in N.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trueup import Parameter, ParameterSpace, Recording, Trial
from trueup.articulated.declaration_file import read_declarations
from trueup.articulated.declarations import declare
from trueup.articulated.described import Described, StoredCopies
from trueup.articulated.quantities.quantity import Quantity, factor
from trueup.articulated.simulator import ArticulatedSimulator
from trueup.controllers.controller import Observation
from trueup.engines.simulator import Rollout
from trueup.recording import Channel
from trueup.trial import Observed

Array = NDArray[np.float64]
GRAVITY, DURATION, PERIOD, STRONGEST = 9.81, 4.0, 0.02, 15.0  # m/s2, s, s, N

# ---- the engine: what the robot consists of, and how it moves ----

NUMBERS = {
    ("body.mass", "cart"): 1.0, ("body.mass", "pole"): 0.2, ("pole.length", "pole"): 0.5, ("joint.slides", "cart"): 1.0,
    ("joint.damping", "cart"): 0.1, ("joint.damping", "pole"): 0.002, ("actuator.gain", "motor"): 1.0,
    ("joint.friction", "cart"): 0.0,
}  # fmt: skip


class CartPole(Described):
    """A point mass on a rod on a cart; all copies at once."""

    def __init__(self, numbers: dict[tuple[str, str], float] = NUMBERS) -> None:
        super().__init__("cart-pole", {"cart": "motor", "pole": ""}, numbers)

    def advance(self, copies: StoredCopies, force: Array, step: float) -> None:
        m, length = copies.get("body.mass", "pole"), copies.get("pole.length", "pole")
        angle, (speed, rate) = copies.position[:, 1], copies.velocity.T
        sin, cos = np.sin(angle), np.cos(angle)
        push = copies.get("actuator.gain", "motor") * force[:, 0]
        dry = copies.get("joint.friction", "cart") * np.tanh(speed / 0.02)
        drag = copies.get("joint.damping", "pole") * rate / (m * length)
        along = push - dry - copies.get("joint.damping", "cart") * speed + m * length * sin * rate**2
        turned = along + m * cos * (GRAVITY * sin + drag)
        acceleration = turned / (copies.get("body.mass", "cart") + m * sin**2)
        turning = -(cos * acceleration + GRAVITY * sin + drag) / length
        copies.velocity = copies.velocity + step * np.stack([acceleration, turning], axis=1)
        copies.position = copies.position + step * copies.velocity
        copies.force = np.stack([push, np.zeros_like(push)], axis=1)


# ---- a quantity that trueup does not know: [[parameter]] quantity = "cart_pole:LENGTH" ----

LENGTH = Quantity(
    name="length", family="pole", unit="m", title="from the pivot to the centre of mass", scale="log",
    bounds=factor(2, 2, 0.1), attributes=("pole.length",), start=None, shown_by="swinging",
)  # fmt: skip


def simulator(parameters: Path) -> ArticulatedSimulator:
    """The engine with the parameters of a file."""
    model = CartPole()
    return ArticulatedSimulator(model, *declare(model, read_declarations(parameters)), step=0.01)


# ---- the controller: pumps energy into the pole and holds the cart back ----


class Pump:
    """Two gains (b, 2): of the pole's swing in N s/rad, and of the cart's place in N/m."""

    period = PERIOD

    def __init__(self, gains: Array) -> None:
        self._swing, self._centre = gains.T

    def reset(self, observation: Observation) -> None:
        """Nothing to remember."""

    def command(self, observation: Observation) -> Array:
        (x, angle), (speed, rate) = observation.position.T, observation.velocity.T
        push = np.where(observation.time < 0.3, 5.0, -self._swing * rate * np.cos(angle))  # a push to begin with
        return np.clip(push - self._centre * (x + 0.3 * speed), -STRONGEST, STRONGEST)[:, None]


# ---- the task ----


class SwingUp:
    """How far the pole stays below upright at its highest, 0 ... 1, with a price on the track that it takes, per m."""

    name = "swing up"

    def __init__(self, price: float = 0.1) -> None:
        self._price = price
        self.parameters = ParameterSpace((
            Parameter("swing", "N s/rad", 0.5, 0.1, 5.0, scale="log"),
            Parameter("centre", "N/m", 3.0, 0.5, 30.0, scale="log"),
        ))  # fmt: skip
        time = np.arange(0.0, DURATION, PERIOD)
        joints, motor = Observed(("cart", "pole"), "rad", time), Observed(("motor",), "N", time)
        self.trials = (Trial("swing", 0.0, DURATION, None, {"position": joints, "command": motor}),)

    def controllers(self, values: Array) -> Pump:
        return Pump(values)

    def score(self, rollouts: Sequence[Rollout]) -> Array:
        x, angle = np.moveaxis(rollouts[0].channels["position"], 2, 0)
        return 0.5 * (1.0 + np.cos(angle).min(axis=1)) + self._price * np.abs(x).max(axis=1)


# ---- the robot: a stand-in of another structure, with dry friction, a sagging motor and noise ----

TRUTH = {
    **NUMBERS, ("pole.length", "pole"): 0.6, ("joint.damping", "cart"): 0.4, ("joint.friction", "cart"): 0.3,
    ("actuator.gain", "motor"): 0.85,
}  # fmt: skip


class Robot:
    """Performs a trial with the gains of its settings; the same trial gives the same recording."""

    repeatable = True

    def perform(self, trial: Trial) -> list[Recording]:
        gains = np.array([[trial.settings[name] for name in ("swing", "centre")]])
        (run,) = ArticulatedSimulator(CartPole(TRUTH), step=0.001).rollout([trial], gains, Pump)
        rng = np.random.default_rng(zlib.crc32(trial.name.encode()))
        noise = {"position": 0.002, "command": 0.0}
        return [
            Recording(trial.name if trial.repeats == 1 else f"{trial.name}-{k + 1}", {
                name: Channel(name, o.labels, o.unit, o.time,
                              run.channels[name][0] + noise[name] * rng.standard_normal((len(o.time), len(o.labels))))
                for name, o in trial.observed.items()
            })
            for k in range(trial.repeats)
        ]  # fmt: skip
