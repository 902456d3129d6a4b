# SPDX-License-Identifier: Apache-2.0
"""The study's report as Markdown: the papers' tables with the stand-in's figures, factors, answers to open questions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.evidence import half_interval
from trueup.studies.arm.comparison import ALGORITHMS, CASES, Errors, interval, redrawn, share_of_best, weights
from trueup.studies.arm.factors import CLAIMS, Cell, Ratio, bounds, main_effect
from trueup.studies.arm.robot import NOMINAL

_PAPERS = {  # local identification, table II: mean absolute error in % of nominal torque, axes 1-6
    "1 local": {"A": (2.6, 3.7, 2.5, 7.0, 3.6, 30.1), "A_local": (3.2, 2.2, 3.1, 11.5, 4.1, 16.6),
                "B": (1.9, 1.7, 2.1, 3.1, 2.9, 4.2)},
    "2 wide sines": {"A": (1.9, 1.5, 1.2, 1.8, 2.0, 6.9), "A_local": (2.0, 5.0, 4.4, 2.2, 2.3, 4.6),
                     "B": (8.0, 4.5, 4.4, 2.8, 2.2, 3.6)},
    "3 wide planner": {"A": (7.2, 6.1, 4.4, 12.9, 8.0, 21.5), "A_local": (9.1, 10.6, 6.8, 17.5, 7.5, 14.3),
                       "B": (38.8, 10.4, 13.1, 11.2, 7.5, 4.6)},
}  # fmt: skip
_AXES = ("", *(f"axis {k}" for k in range(1, 7)))


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    return "\n".join("| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rows)) + "\n"


def summary(errors: Errors, rng: np.random.Generator) -> str:
    """Each algorithm's error on each case, mean over axes, % of nominal, with interval."""
    rows = []
    for case in CASES:
        cells = []
        for algorithm in ALGORITHMS:
            values = (100.0 * errors.absolute[algorithm, case] / NOMINAL).mean(axis=2, keepdims=True)
            low, high = interval(values, rng)
            cells.append(f"{values.mean():.1f} [{low[0]:.1f}, {high[0]:.1f}]")
        rows.append([case, *cells])
    return table(("test case", *ALGORITHMS), rows)


def ratio_table(found: Mapping[tuple[Cell, str], Ratio]) -> str:
    """One row a combination of factors, one column a claim."""
    cells = list(dict.fromkeys(cell for cell, _ in found))
    rows = [[c.region, c.effects, c.speed, c.ramp, *(found[c, claim].text for claim in CLAIMS)] for c in cells]
    return table(("region", "hidden", "speed", "planner", *CLAIMS), rows)


def main_effects_table(found: Mapping[tuple[Cell, str], Ratio], levels: Mapping[str, tuple[str, str, str]]) -> str:
    """One row a factor: what its second level does to each ratio. `levels`: words -> field of Cell, first, second."""
    rows = [[words, *(main_effect(found, claim, *level) for claim in CLAIMS)] for words, level in levels.items()]
    return table(("factor", *CLAIMS), rows)


def local_or_global(errors: Mapping[str, Errors], seed: int) -> str:
    """Local over global excitation, pairs of algorithms, on each case; geometric mean over axes and regions."""
    pairs = (("A_local", "A"), ("B fast", "A"), ("B slow", "A"), ("B many", "A many"))
    rows = []
    for local, wide in pairs:
        cells = []
        for case in CASES:
            logs = []
            for region, each in errors.items():
                rng, shape = np.random.default_rng([seed, *region.encode()]), each.absolute[wide, case].shape
                drawn = weights(shape[0], rng, 1000), weights(shape[1], rng, 1000)
                logs.append(
                    np.log(redrawn(each.absolute[local, case], *drawn) / redrawn(each.absolute[wide, case], *drawn))
                )
            draws = np.mean(logs, axis=(0, 2))
            cells.append(f"{np.exp(draws.mean()):.2f} [{bounds(draws)}]")
        rows.append([f"{local} over {wide}", *cells])
    return table(("", *CASES), rows)


def after_search_table(ranks: Sequence[Mapping[str, tuple[Array, Array]]], rng: np.random.Generator) -> str:
    """Rank correlation of determinant and minus error within algorithm and region, pooled over regions."""
    rows = []
    for algorithm in ranks[0]:
        one, other = (np.concatenate([each[algorithm][k] for each in ranks]) for k in (0, 1))
        again = rng.integers(len(one), size=(1000, len(one)))
        value = -float(one @ other / np.sqrt((one @ one) * (other @ other)))
        drawn = -np.sum(one[again] * other[again], 1) / np.sqrt(
            np.sum(one[again] ** 2, 1) * np.sum(other[again] ** 2, 1) + 1e-12
        )
        low, high = np.nanquantile(drawn, [0.025, 0.975])
        rows.append([algorithm, str(len(one)), f"{value:.2f} [{low:.2f}, {high:.2f}]"])
    return table(("algorithm", "excitations", "rank correlation"), rows)


def table_one(determinants: Mapping[str, Mapping[str, Sequence[float]]]) -> str:
    """Local identification, table I: log10 det as printed, by region and algorithm (range over the excitations)."""
    rows = [
        [region, algorithm, f"{min(values):.0f} ... {max(values):.0f}"]
        for region, each in determinants.items() for algorithm, values in each.items()
    ]  # fmt: skip
    return table(("region", "algorithm", "log10 det [H^T H], 2000 samples"), rows) + (
        "\nThe paper: A 182, A_local 160 (2000 samples), B 47.6 (2875 samples).\n"
    )


def table_two(errors: Errors, rng: np.random.Generator) -> str:
    """Table II: for each case mean absolute error, its spread over trajectories, RMSE and ||e||/S, in N m and %."""
    text = ""
    for case in CASES:
        rows = []
        for algorithm in ALGORITHMS:
            e, low_high = errors.absolute[algorithm, case], interval(errors.absolute[algorithm, case], rng, 400)
            rmse = np.sqrt(errors.squared[algorithm, case].mean(axis=(0, 1)))
            printed = np.sqrt(errors.squared[algorithm, case] / errors.samples[case][:, None]).mean(axis=(0, 1))
            mean, spread = e.mean(axis=(0, 1)), e.std(axis=(0, 1))
            rows.append([f"{algorithm}, N m", *(f"{m:.1f} ± {s:.1f}" for m, s in zip(mean, spread, strict=True))])
            rows.append([f"{algorithm}, %", *(
                f"{100 * m / t:.1f} [{100 * a / t:.1f}, {100 * b / t:.1f}]"
                for m, a, b, t in zip(mean, *low_high, NOMINAL, strict=True)
            )])  # fmt: skip
            rows.append([f"{algorithm}, RMSE N m (%)", *_both(rmse)])
            rows.append([f"{algorithm}, ‖e‖/S N m (%)", *_both(printed)])
        text += f"\n**Test case {case}**\n\n" + table(_AXES, rows)
    return (
        text
        + "\n**As printed in the paper**, mean absolute error in %\n\n"
        + table(
            _AXES,
            [[f"{case}: {a}", *map(str, values)] for case, each in _PAPERS.items() for a, values in each.items()],
        )
    )


def _both(values: Array) -> list[str]:
    return [f"{v:.2f} ({100 * v / t:.2f})" for v, t in zip(values, NOMINAL, strict=True)]


def table_three(names: Sequence[str], truth: Sequence[float], found: Mapping[str, Sequence[float]]) -> str:
    """Table III: the 58 parameters as each algorithm's first excitation gives them, beside the truth of the rigid part."""
    head = ("parameter", "truth", *found)
    rows = [
        [name, f"{truth[k]:.3f}", *(f"{values[k]:.3f}" for values in found.values())] for k, name in enumerate(names)
    ]
    return table(head, rows)


def factors(results: Mapping[str, Errors], rng: np.random.Generator) -> str:
    """Each hidden effect left out, and all: mean over axes of the error in % of nominal, by algorithm and case."""
    text = ""
    for case in CASES:
        rows = []
        for name, errors in results.items():
            share = share_of_best(errors, rng)[0]
            cells = [f"{errors.percent(a, case).mean():.1f}" for a in ALGORITHMS]
            rows.append([name, *cells, f"{100 * share:.0f} %"])
        text += f"\n**Test case {case}**\n\n" + table(("effects", *ALGORITHMS, "cells in which ours is best"), rows)
    return text


def shares(results: Mapping[str, Errors]) -> str:
    """How often a model gives some motion negative energy: share of random postures, mean over the excitations."""
    rows = [
        [name, *(f"{100 * float(errors.indefinite[a].mean()):.1f} %" for a in ALGORITHMS)]
        for name, errors in results.items()
    ]
    return table(("effects", *ALGORITHMS), rows)


def correlations(answers: Sequence[Mapping[str, Any]]) -> str:
    """Spearman's coefficient of each criterion with what was got wrong, over random excitations (questions.Answers).

    Intervals by Fisher's transformation, with the variance for ranks of Fieller, Hartley & Pearson, 1957.
    """
    text = ""
    for one in answers:
        doubt = half_interval() * np.sqrt(1.06 / max(one["count"] - 3, 1))
        rows, outcomes = [], list(next(iter(one["correlation"].values())))
        for criterion, each in one["correlation"].items():
            middle = {o: np.arctanh(np.clip(each[o], -0.999, 0.999)) for o in outcomes}
            low_high = {o: np.tanh([middle[o] - doubt, middle[o] + doubt]) for o in outcomes}
            rows.append([criterion, *(f"{each[o]:.2f} [{low_high[o][0]:.2f}, {low_high[o][1]:.2f}]" for o in outcomes)])
        text += f"\n**Class {one['kind']}**, {one['count']} random excitations\n\n"
        text += table(("criterion", *(f"error: {o}" for o in outcomes)), rows)
    return text
