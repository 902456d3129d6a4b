# SPDX-License-Identifier: Apache-2.0
"""What smooth interpolation and feedback earn: motions of each kind that hold, and how much noise and pushing they stand.

The peer of each kind is the paper's: linear between keyframes, no feedback. All are searched alike, from the same seeds, in
as many simulations, and while they are pushed a little: gains earn nothing where nothing disturbs.
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import replace

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from results import result

from trueup.chance import Disturbance, Push
from trueup.controllers.keyframes import pitch_of
from trueup.engines.simulator import Simulator
from trueup.loop.confirm import NOISE, hunt, margin
from trueup.studies.balance.scenes import transition
from trueup.tasks.transitions import Transition

STEP, BUDGET = 0.004, 1600
GAINS = {"heel": (1.0, 0.15), "thigh": (1.0, 0.15)}
"""Of ankle and hip, each up to so many rad per rad of tilt, and per rad/s."""
KINDS = {
    "linear": ("linear", {}),
    "smooth": ("smooth", {}),
    "feedback": ("linear", GAINS),
    "smooth feedback": ("smooth", GAINS),
}


def made(scene: str, kind: str) -> tuple[Simulator, Transition]:
    """A scene with motions of one kind."""
    interpolation, gains = KINDS[kind]
    simulator, task = transition(scene, step=STEP)
    motion = replace(task.motion, interpolation=interpolation, feedback=gains)
    return simulator, replace(task, motion=motion, tilt=pitch_of() if gains else None)


def shove(task: Transition, force: float) -> tuple[Disturbance, ...]:
    """A push of the torso from anywhere, of half to a whole `force` in N, for a tenth of a second once it should stand."""
    begin = task.duration - task.after
    return (Push("torso", (0.5 * force, force), (begin, begin + 0.1), (0.1, 0.1)),)


def one(scene: str, kind: str, seed: int, budget: int) -> tuple[bool, float, float]:
    """Whether a motion that holds was found, and the shares of replays in which the sturdiest stands noise, and pushes."""
    simulator, task = made(scene, kind)
    rng, begun = np.random.default_rng(seed), time.process_time()
    found = hunt(task, simulator, rng, wanted=6, simulations=budget, rough=(*NOISE, *shove(task, 2.0)))
    if not found.winners:
        print(f"{scene}, {kind}, seed {seed}: nothing that holds in {found.simulations} simulations", flush=True)
        return False, 0.0, 0.0
    best = [found.winners[0].values]
    noise = float(margin(task, simulator, best, rng, replays=16)[0][0])
    pushed = float(margin(task, simulator, best, rng, noise=shove(task, 2.0), replays=16)[0][0])
    print(f"{scene}, {kind}, seed {seed}: {len(found.winners)} hold, {found.simulations} simulations, stands {noise:.0%} of "
          f"noise and {pushed:.0%} of pushes, {time.process_time() - begun:.1f} CPU s", flush=True)  # fmt: skip
    return True, noise, pushed


def main() -> None:
    """Prints, for each kind, seeds from which a motion was found, and shares of replays that stood noise and pushes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one seed, fewer simulations")
    parser.add_argument("--scene", default="kneel-to-stand")
    parser.add_argument("--seeds", type=int, default=4)
    asked = parser.parse_args()
    seeds, budget = (1, 320) if asked.quick else (asked.seeds, BUDGET)
    each = {
        kind: np.array([one(asked.scene, kind, seed, budget) for seed in range(seeds)], dtype=float) for kind in KINDS
    }
    for kind, rows in each.items():
        share, noise, pushed = rows.mean(axis=0)
        print(f"{kind}: found from {share:.0%} of seeds, stands {noise:.0%} of noise and {pushed:.0%} of pushes")
    plain = each["linear"].mean(axis=0)
    for kind in ("smooth", "feedback", "smooth feedback"):
        _, noise, pushed = each[kind].mean(axis=0)
        for what, value, other in (("noise", noise, plain[1]), ("pushes", pushed, plain[2])):
            result(f"{kind.replace(' ', '_')}_{what}_stood", value, "share of replays", 1.0, peer="linear, no feedback",
                   peer_value=other, at_most=False, ratio_goal=True)  # fmt: skip


if __name__ == "__main__":
    main()
