# SPDX-License-Identifier: Apache-2.0
"""How well a motion would identify a dynamic model: D-, A-, E-optimality, condition number, prediction.

All start from the information matrix M = sum_i w_i^2 G_i, with G_i the Gram matrix of joint i's regressor rows for the
base columns and w_i the weight of joint i. Losses, lower is better; log10 throughout.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trueup.arrays import Array, Integers, Mask
from trueup.errors import IdentificationError, unknown_name
from trueup.excitation.trajectories import Motions
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.information import log_determinants
from trueup.rounding import TINY

Kind = Literal["D", "A", "E", "condition", "prediction"]
Weighting = Literal["nominal", "printed"]
Friction = Literal["with", "without", "alone"]
KINDS: tuple[Kind, ...] = ("D", "A", "E", "condition", "prediction")


@dataclass(frozen=True, eq=False)
class Criterion:
    """A loss of motions. `Criterion.of` computes what the fields cannot know."""

    model: DynamicModel
    independent: Integers
    """(c,) the base columns among the model's."""
    torque: Array
    """(n,) nominal torque of the joints, N m."""
    kind: Kind = "D"
    weighting: Weighting = "nominal"
    per_sample: bool = True
    friction: Friction = "with"
    scale: Array = field(default_factory=lambda: np.ones(0))
    """(c,) typical size of each parameter: A, E and the condition number mean nothing in mixed units without it."""
    expected: Array | None = None
    """(c, c) information matrix per sample of the motions whose torque is to be predicted, for 'prediction'."""

    @classmethod
    def of(
        cls, model: DynamicModel, torque: ArrayLike, kind: Kind = "D", *, weighting: Weighting = "nominal",
        per_sample: bool = True, friction: Friction = "with", seed: int = 0,
    ) -> Criterion:  # fmt: skip
        """A criterion for the base columns of a model; nominal `torque` (n,) in N m.

        kind: 'D' the determinant, 'A' the sum of variances, 'E' the worst variance, 'condition' the condition number,
        'prediction' the mean variance of the torque on other motions (`for_motions` says which).
        weighting: 'printed' multiplies rows by tau_nom / max tau_nom (Sub-workspace evolved trajectories, eq. 6),
        'nominal' divides them by tau_nom, as weighted least squares with noise in proportion to tau_nom does.
        per_sample: of the mean over samples instead of the sum, so that length alone is no merit.
        friction: 'with' all columns; 'without' the friction columns; 'alone' only the friction parameters, with the
        others as unknown as they are (their Schur complement): which motion tells friction best.

        Raises IdentificationError for torques that are not above zero, UnknownNameError for an unknown kind.
        """
        nominal = np.asarray(torque, dtype=np.float64)
        if kind not in KINDS:
            raise unknown_name("criterion", kind, KINDS, "the criteria of excitation")
        if nominal.shape != (model.tree.n,) or not (nominal > 0).all():
            raise IdentificationError(
                f"nominal torques must be {model.tree.n} values above 0 N m; got {nominal.tolist()}"
            )
        independent = np.asarray(model.base(seed=seed).independent, dtype=np.int64)
        if friction == "without":
            independent = independent[~model.friction[independent]]
        made = cls(model, independent, nominal, kind, weighting, per_sample, friction)
        return replace(made, scale=made._typical(seed))

    def for_motions(self, motions: Motions) -> Criterion:
        """The 'prediction' criterion for motions like these: the mean variance of their torque is the loss."""
        possible = motions.possible
        total = self._information(motions, possible, 1).sum(axis=0)
        return replace(self, kind="prediction", expected=total / (possible.sum() * motions.q.shape[1]))

    def smooth(self, rest: float = 0.05) -> Criterion:
        """The same with signs of speeds that fade below `rest` rad/s, so that slopes of the loss exist on coarse samples."""
        return replace(self, model=replace(self.model, rest=max(rest, self.model.rest)))

    @property
    def weights(self) -> Array:
        """(n,) what the rows of each joint are multiplied by."""
        return self.torque / self.torque.max() if self.weighting == "printed" else 1.0 / self.torque

    def losses(self, motions: Motions, threads: int = 1, *, as_of: int | None = None) -> Array:
        """(B,) of motions, lower is better; NaN for impossible ones, inf for those that leave a parameter unseen.

        `as_of`: sums over samples are brought to this many of them, so that coarse samples can stand for fine ones.
        """
        loss = np.full(len(motions.q), np.nan)
        rows = np.flatnonzero(motions.possible)
        if len(rows):
            M = self._information(motions, rows, threads)
            count = motions.q.shape[1]
            loss[rows] = self.of_information(M * ((as_of or count) / count), as_of or count)
        return loss

    def _information(self, motions: Motions, rows: NDArray[Any], threads: int) -> Array:
        of = (motions.q[rows], motions.qd[rows], motions.qdd[rows])
        return self.model.information(*of, self.weights, self.independent, threads=threads)

    def of_information(self, M: Array, samples: int) -> Array:
        """(...,) losses of information matrices (..., c, c) summed over `samples` samples."""
        if self.per_sample:
            M = M / samples
        if self.friction == "alone":
            M = self._friction_alone(M)
        if self.kind == "D":
            return -log_determinants(M.reshape(-1, *M.shape[-2:])).reshape(M.shape[:-2]) / np.log(10.0)
        chosen = self._friction if self.friction == "alone" else slice(None)
        scaled = M * self.scale[chosen, None] * self.scale[None, chosen]
        values = np.linalg.eigvalsh(scaled)
        least = values[..., 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.kind == "E":
                return np.where(least > 0, -np.log10(least), np.inf)
            if self.kind == "condition":
                return np.where(least > 0, 0.5 * np.log10(values[..., -1] / least), np.inf)
            if self.kind == "A":
                return np.where(least > 0, np.log10((1.0 / values).sum(axis=-1)), np.inf)
        return self._prediction(M)

    def printed(self, motions: Motions) -> Array:
        """(B,) log10 det [H^t H] as both papers print it (eq. 6-7, 8-9): summed over samples, higher is better."""
        as_printed = replace(self, kind="D", weighting="printed", per_sample=False, friction="with")
        return -as_printed.losses(motions)

    @property
    def _friction(self) -> Mask:
        return self.model.friction[self.independent]

    def _friction_alone(self, M: Array) -> Array:
        own = self._friction
        others = np.linalg.pinv(M[..., ~own, :][..., :, ~own], hermitian=True)
        cross = M[..., own, :][..., :, ~own]
        return M[..., own, :][..., :, own] - cross @ others @ np.swapaxes(cross, -1, -2)

    def _prediction(self, M: Array) -> Array:
        if self.expected is None:
            raise IdentificationError("the criterion 'prediction' needs motions to predict: use for_motions(...)")
        chosen = self._friction if self.friction == "alone" else slice(None)
        expected = self.expected[chosen][:, chosen]
        loss = np.full(M.shape[:-2], np.inf)
        for at in np.ndindex(*loss.shape):
            try:
                variance = float(np.trace(np.linalg.solve(M[at], expected)))
            except np.linalg.LinAlgError:
                continue
            if variance > 0:
                loss[at] = 0.5 * np.log10(variance)
        return loss

    def _typical(self, seed: int) -> Array:
        """(c,) the size at which each parameter alone makes as much weighted torque as the others, on random states."""
        rng, n = np.random.default_rng(seed), self.model.tree.n
        q, qd, qdd = (rng.uniform(-a, a, (1, 300, n)) for a in (np.pi, 2.0, 5.0))
        M = self.model.information(q, qd, qdd, self.weights, self.independent)[0] / 300
        return 1.0 / np.sqrt(np.maximum(np.diag(M), TINY))
