# SPDX-License-Identifier: Apache-2.0
"""A dynamic model with its numbers: torque for any motion, in words, and as a file that is read back."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trueup import files
from trueup.arrays import Array
from trueup.errors import ModelError, TrueupError
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.effects import OF_LOAD, Effect
from trueup.identification.inertial import NAMES
from trueup.identification.kinematic_tree import GEOMETRY, KinematicTree
from trueup.identification.regressors import inverse_dynamics, samples
from trueup.recording import Channel, Recording

FILE = "torque.json"
FORMAT = "trueup torque model 1"


@dataclass(frozen=True, eq=False)
class TorqueModel:
    """Torque (N m, N) of an arm's joints for any motion: rigid links, and what drives add, term by term.

    Arrays are read-only by convention. `load` (n, 10) are the links that the effects of load are computed from.
    """

    tree: KinematicTree
    links: Array
    """(n, 10) in the order of `trueup.identification.inertial`; combinations that torque can tell, so that a single number
    need not be that of a body."""
    drives: Array
    """(n, n) speeds of the drives, geared to their joints, for speeds of the joints."""
    terms: tuple[tuple[int, Effect, float], ...]
    """(drive, effect, coefficient)."""
    load: Array
    units: tuple[str, ...]
    """Of each joint's torque."""

    @classmethod
    def of(cls, model: DynamicModel, parameters: Array, load: Array, units: Sequence[str]) -> TorqueModel:
        """The model with parameters (p,); effects of coefficient zero are left out."""
        n = model.tree.n
        values = zip(model.effects, parameters[10 * n :].tolist(), strict=True)
        terms = tuple((d, effect, value) for (d, effect), value in values if value != 0.0)
        return cls(model.tree, parameters[: 10 * n].reshape(n, 10), model.drives, terms, load, tuple(units))

    @classmethod
    def of_file(cls, tree: KinematicTree, units: Sequence[str]) -> TorqueModel:
        """What a model file says: bodies, rotors, friction, damping, springs. Raises ModelError for one without inertias."""
        kinds = (("rotor", tree.armature), ("coulomb", tree.friction), ("viscous", tree.damping),
                 ("torsion", tree.stiffness), ("offset", -tree.stiffness * tree.slack))  # fmt: skip
        terms = [(d, Effect(kind), float(x)) for kind, values in kinds for d, x in enumerate(values) if x != 0.0]
        return cls(tree, tree.weighed(), np.eye(tree.n), tuple(terms), np.zeros((tree.n, 10)), tuple(units))

    @property
    def joints(self) -> tuple[str, ...]:
        """Names, in the order of the columns."""
        return self.tree.joints

    @property
    def of_load(self) -> bool:
        """Whether friction depends on the torque that gears carry."""
        return any(effect.kind in OF_LOAD for _, effect, _ in self.terms)

    def torque(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Array:
        """(S, n) torque at positions, speeds, accelerations (S, n) in rad, rad/s, rad/s^2 (m, ...); or (n,) at one (n,).

        Samples are those of one motion in the order of time: hysteresis remembers the way, and starts at rest in the first.
        Raises ModelError where shapes do not fit.
        """
        single = np.ndim(q) == 1
        q_, v, a = samples(self.tree, q, qd, qdd)
        torque = inverse_dynamics(self.tree, self.links, q_, v, a)
        dq, dv, da = (x @ self.drives.T for x in (q_, v, a))
        carried = (
            inverse_dynamics(self.tree, self.load, q_, v, a) @ np.linalg.inv(self.drives) if self.of_load else None
        )
        own = np.zeros_like(torque)
        for d, effect, value in self.terms:
            own[:, d] += value * effect.column(
                dq[:, d], dv[:, d], da[:, d], load=None if carried is None else carried[:, d]
            )
        torque += own @ self.drives
        return torque[0] if single else torque

    def predict(self, recording: Recording, cutoff: float | None = None) -> Recording:
        """Positions, speeds and torques along a recording's motion, at even instants; columns become joints by name.

        Everything above `cutoff` Hz is filtered away, by default as `trueup identify` would do it. Raises ModelError where a
        joint is missing, IdentificationError for positions that cannot be used.
        """
        from trueup.identification.estimation.cutoff import natural_cutoff
        from trueup.identification.estimation.drives import Drives
        from trueup.identification.estimation.filtering import Lowpass
        from trueup.identification.estimation.matching import matched
        from trueup.identification.estimation.motion import log_of

        q = recording.channel("position")
        nothing = Channel("torque", q.labels, "N m", q.time, np.zeros(q.values.shape))
        tree, ((named,), _), _ = matched(
            self.tree, ([recording.replace(channels={"position": q, "torque": nothing})], [])
        )
        if tree.joints != self.joints:
            missing = ", ".join(j for j in self.joints if j not in tree.joints)
            raise ModelError(f"recording '{recording.name}' has no position of {missing}, which the torque model needs")
        log = log_of(named, tree, Drives.direct(tree.joints))
        used = cutoff or natural_cutoff([log])
        m = log.motion(used, measured_speed=False)
        passed = Lowpass(m.rate, used) if used < 0.45 * m.rate else np.asarray
        units = tuple("m" if slides else "rad" for slides in tree.prismatic.tolist())
        made = (("position", "rad", m.q, units), ("velocity", "rad/s", m.v, tuple(f"{u}/s" for u in units)),
                ("torque", "N m", passed(self.torque(m.q, m.v, m.a)), self.units))  # fmt: skip
        channels = {name: Channel(name, self.joints, unit, m.time, values, own) for name, unit, values, own in made}
        return Recording(recording.name, channels)

    def expression(self, drive: int) -> str:
        """What a drive adds, of its q, v, a and load L, as C and Python both read it: '0.41*(a) + 12.3*(tanh(v/0.013))'."""
        parts = [f"{value!r}*({_scaled(effect)})" for d, effect, value in self.terms if d == drive]
        return " + ".join(parts) or "0.0"

    def formulas(self) -> tuple[str, ...]:
        """The whole model in words and formulas, one line a joint or drive."""
        n, said = self.tree.n, []
        coupled = np.count_nonzero(self.drives) > n
        for d, joint in enumerate(self.joints):
            parts = [
                f"{value:.6g} {_scaled(effect, 4)}".removesuffix(" 1.0") for k, effect, value in self.terms if k == d
            ]
            whole = " + ".join([*([] if coupled else [f"rigid[{joint}]"]), *parts]) or "0"
            said.append(f"{'u' if coupled else 'torque'}[{joint}] = {whole.replace('+ -', '- ')}")
        if coupled:
            sums = zip(self.joints, self.drives.T, strict=True)
            said += [f"torque[{joint}] = rigid[{joint}] + {_sum(column, self.joints, 'u')}" for joint, column in sums]
        for d in np.flatnonzero(np.count_nonzero(self.drives, axis=1) > 1).tolist():
            said += [f"{x} of the drive {self.joints[d]} = {_sum(self.drives[d], self.joints, x)}" for x in "qva"]
        return (*said, *self.legend())

    def legend(self) -> tuple[str, ...]:
        """What the symbols of the formulas are."""
        kinds = {effect.kind for _, effect, _ in self.terms}
        said = [
            "rigid: inverse dynamics (Newton-Euler) of the links, without rotors",
            "q, v, a: position, speed, acceleration of the joint, or of the drive where drives are coupled",
        ]
        if kinds & set(OF_LOAD):
            said.append(
                "L: torque that the gear carries, by inverse dynamics of the links that are given for it (load_links)"
            )
        if "hysteresis" in kinds:
            said.append("stop(q, s): grows by dq / s, kept within -1 ... 1, 0 at first")
        return tuple(said)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and texts, as `from_dict` reads them."""
        return {
            "format": FORMAT, "joints": list(self.joints), "units": list(self.units),
            "tree": {"name": self.tree.name, "links": list(self.tree.links),
                     **{k: np.asarray(getattr(self.tree, k)).tolist() for k in GEOMETRY}},
            "numbers_of_a_link": list(NAMES), "links": self.links.tolist(), "drives": self.drives.tolist(),
            "terms": [{"joint": self.joints[d], "effect": e.kind, "coefficient": value, "formula": _scaled(e),
                       "scale": e.scale if e.scaled else None, "unit": e.unit(bool(self.tree.prismatic[d]))}
                      for d, e, value in self.terms],
            "load_links": self.load.tolist(), "formulas": list(self.formulas()),
        }  # fmt: skip

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> TorqueModel:
        """The model that `to_dict` wrote. Raises KeyError, TypeError, ValueError and TrueupError for anything else."""
        joints = tuple(str(j) for j in data["joints"])
        shape = data["tree"]
        tree = KinematicTree.of_geometry(str(shape["name"]), joints, tuple(shape["links"]), shape)
        terms = tuple(
            (joints.index(t["joint"]), Effect(t["effect"], *([float(t["scale"])] if t["scale"] is not None else [])),
             float(t["coefficient"]))
            for t in data["terms"]
        )  # fmt: skip
        links, load = (np.asarray(data[k], dtype=float).reshape(tree.n, 10) for k in ("links", "load_links"))
        drives = np.asarray(data["drives"], dtype=float).reshape(tree.n, tree.n)
        numbers = [links, load, drives, *(getattr(tree, k) for k in GEOMETRY), [c for _, _, c in terms]]
        if not all(np.isfinite(x).all() for x in numbers) or len(data["units"]) != tree.n:
            raise ValueError("numbers are missing or not finite")
        return cls(tree, links, drives, terms, load, tuple(str(u) for u in data["units"]))


def load(folder: str | Path) -> TorqueModel:
    """The predictor in a folder that `trueup identify` wrote (or its file torque.json).

    `load(folder).torque(q, qd, qdd)` is torque in N m for motion in rad, rad/s, rad/s^2. Raises ModelError where there is
    none that can be read.
    """
    path = Path(folder)
    file = path / FILE if path.is_dir() else path
    if not file.exists():
        raise ModelError(
            f"there is no torque model in '{path}': {FILE} is missing; `trueup identify ... --out DIR` writes one to DIR"
        )
    try:
        data = json.loads(files.text(file, ModelError))
    except (ValueError, RecursionError) as error:
        raise ModelError(f"'{file}' is not a torque model: {error}") from None
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        said = data.get("format") if isinstance(data, dict) else type(data).__name__
        raise ModelError(
            f"'{file}' is not a torque model that this version reads: format {said!r}, expected '{FORMAT}'"
        )
    try:
        return TorqueModel.from_dict(data)
    except (KeyError, TypeError, ValueError, AttributeError, TrueupError) as error:
        raise ModelError(f"'{file}' is damaged: {type(error).__name__}: {error}") from None


def _scaled(effect: Effect, digits: int = 17) -> str:
    """The effect's formula with its scale filled in."""
    if not effect.scaled:
        return effect.formula
    number = repr(effect.scale) if digits >= 17 else f"{effect.scale:.{digits}g}"
    return effect.formula.replace("/s", f"/{number}").replace(", s)", f", {number})")


def _sum(weights: Array, names: Sequence[str], symbol: str) -> str:
    parts = [
        f"{'' if w == 1.0 else f'{w:.6g} '}{symbol}[{name}]" for w, name in zip(weights, names, strict=True) if w != 0.0
    ]
    return " + ".join(parts).replace("+ -", "- ")
