# SPDX-License-Identifier: Apache-2.0
"""Learners find what is hidden in rows, errors are Weka's, and what is kept predicts as the learner's library does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.errors import GroundingError, UnknownNameError
from trueup.evidence import evidence
from trueup.grounding.comparison import cross_validated, folds_by_row, folds_by_run, score
from trueup.grounding.domain import domain_of
from trueup.grounding.grounding import Grounding
from trueup.grounding.learn import Wishes, learn, no_worse_than_a_line
from trueup.grounding.learners import LEARNERS, learners, tempered
from trueup.grounding.linear import pace
from trueup.grounding.remarks import remark_of_share
from trueup.grounding.rows import inputs_of, rows_of
from trueup.grounding.views import VIEWS, fitted
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]
JOINTS = ("hip", "knee")
PERIOD = 0.02


def lag(state: Array, command: Array) -> Array:
    """A linear joint: it goes part of the way to its command."""
    return state + np.array([0.3, 0.15]) * (command - state)


def limited(state: Array, command: Array) -> Array:
    """The same with a limit of speed: piecewise linear."""
    return state + np.clip(np.array([0.3, 0.15]) * (command - state), -0.02, 0.03)


def recordings(
    rng: np.random.Generator, law=lag, runs: int = 6, frames: int = 300, noise: float = 0.0
) -> list[Recording]:
    made = []
    for k in range(runs):
        time = PERIOD * np.arange(frames, dtype=np.float64)
        rates, phases = rng.uniform(0.2, 1.5, (3, 2)), rng.uniform(0.0, 6.0, (3, 2))
        command = 0.3 * np.sin(2 * np.pi * rates * time[:, None, None] + phases).sum(axis=1)
        state = np.zeros((frames, 2))
        for t in range(frames - 1):
            state[t + 1] = law(state[t], command[t])
        seen = state + noise * rng.standard_normal(state.shape)
        each = (Channel("command", JOINTS, "rad", time, command), Channel("position", JOINTS, "rad", time, seen))
        made.append(Recording(f"run {k}", {c.name: c for c in each}))
    return made


@pytest.mark.parametrize("view", VIEWS)
def test_a_linear_joint_is_recovered_whatever_is_looked_at(rng: np.random.Generator, view: str) -> None:
    train, fresh = recordings(rng), recordings(rng, runs=2)
    inputs = inputs_of(train)
    for name in ("linear", "pace", "least-median"):
        model = fitted(LEARNERS[name], rows_of(train, inputs), rng, view)
        rows = rows_of(fresh, inputs)
        assert np.abs(model.predict(rows.X) - rows.Y).max() < 1e-5, name


@pytest.mark.parametrize("name", ["linear", "pace", "least-median", "model-tree"])
def test_legs_that_move_alike_teach_nothing_of_the_last_digits_of_their_commands(
    rng: np.random.Generator, name: str
) -> None:
    def printed(channel: Channel, noise: float) -> Channel:
        alike = channel.values[:, :1] * np.array([1.0, -0.7])
        return channel.replace(values=np.round(alike + noise * rng.standard_normal(alike.shape), 6))

    made = [
        r.replace(channels={n: printed(r.channel(n), noise) for n, noise in (("command", 0.0), ("position", 1e-3))})
        for r in recordings(rng, runs=2, frames=200)
    ]
    rows = rows_of(made, inputs_of(made))
    model = fitted(LEARNERS[name], rows, rng)
    X = np.array(rows.X)
    X[:, rows.inputs.command_columns] += np.array([2e-4, 0.0])  # what no servo tells apart
    assert np.abs(model.predict(X) - model.predict(rows.X)).max() < 2e-3


def test_a_model_tree_finds_a_limit_of_speed_that_a_line_cannot(rng: np.random.Generator) -> None:
    rows = rows_of(recordings(rng, limited), inputs_of(recordings(rng, limited)))
    line, tree = (cross_validated(LEARNERS[n], rows, folds_by_run(rows), "own") for n in ("linear", "model-tree"))
    assert line is not None
    assert tree is not None
    assert np.all(tree.rae < 0.25 * line.rae)
    assert tree.typical < 0.5 * line.typical


def test_predicting_the_mean_is_an_error_of_a_hundred_percent(rng: np.random.Generator) -> None:
    rows = rows_of(recordings(rng), inputs_of(recordings(rng)))
    mean = np.tile(rows.Y.mean(axis=0), (len(rows.Y), 1))
    every = [np.arange(len(rows.Y))]
    found = score("mean", rows, mean, mean, every, np.zeros(1))
    assert found.rae == pytest.approx(1.0)
    assert found.rrse == pytest.approx(1.0)
    half = score("half way", rows, 0.5 * (rows.Y + mean), mean, every, np.zeros(1))
    assert half.rae == pytest.approx(0.5)
    assert half.rrse == pytest.approx(0.5)


def test_outliers_do_not_move_the_least_median_of_squares(rng: np.random.Generator) -> None:
    X = rng.normal(size=(400, 3))
    Y = X @ [[1.0], [-2.0], [0.5]] + 0.01 * rng.standard_normal((400, 1))
    Y[:120] += 20.0  # three rows of ten are wrong
    fits = {n: LEARNERS[n].fit(X, Y, rng).predict(X)[120:] for n in ("linear", "least-median")}
    assert np.abs(fits["least-median"] - Y[120:]).max() < 0.1
    assert np.abs(fits["linear"] - Y[120:]).max() > 1.0


def test_shrunken_coefficients_predict_better_where_few_of_many_inputs_matter(rng: np.random.Generator) -> None:
    gains = []
    for _ in range(10):
        X, fresh = rng.normal(size=(60, 40)), rng.normal(size=(500, 40))
        W = np.zeros((40, 1))
        W[:3] = 1.0
        Y = X @ W + rng.standard_normal((60, 1))
        plain, shrunk = (
            np.mean((f(X, Y, rng).predict(fresh) - fresh @ W) ** 2) for f in (LEARNERS["linear"].fit, pace)
        )
        gains.append(np.log(plain / shrunk))
    assert np.mean(gains) > 2.0 * np.std(gains) / np.sqrt(len(gains))


def test_what_is_kept_predicts_as_scikit_learn_does(rng: np.random.Generator) -> None:
    neighbors = pytest.importorskip("sklearn.neighbors")
    from sklearn.neural_network import MLPRegressor
    from sklearn.tree import DecisionTreeRegressor

    X, fresh = rng.normal(size=(300, 4)) * [1.0, 5.0, 0.1, 1.0] + 2.0, rng.normal(size=(200, 4)) + 2.0
    Y = np.sin(X[:, :2]) + 0.1 * rng.standard_normal((300, 2))
    stumps = [DecisionTreeRegressor(max_depth=1, random_state=0).fit(X, y).predict(fresh) for y in Y.T]
    assert LEARNERS["stump"].fit(X, Y, rng).predict(fresh) == pytest.approx(np.stack(stumps, axis=1), abs=1e-9)
    Z, z = ((x - X.mean(axis=0)) / X.std(axis=0) for x in (X, fresh))
    theirs = neighbors.KNeighborsRegressor(5).fit(Z, Y).predict(z)
    assert LEARNERS["neighbours"].fit(X, Y, rng).predict(fresh) == pytest.approx(theirs, abs=1e-9)
    seed = int(np.random.default_rng(3).integers(2**31))
    net = MLPRegressor(hidden_layer_sizes=(3,), solver="lbfgs", alpha=1e-3, max_iter=300, random_state=seed)
    theirs = net.fit(Z, (Y - Y.mean(axis=0)) / Y.std(axis=0)).predict(z) * Y.std(axis=0) + Y.mean(axis=0)
    ours = LEARNERS["network"].fit(X, Y, np.random.default_rng(3)).predict(fresh)
    assert ours == pytest.approx(theirs, abs=1e-9)


def test_a_model_tree_never_departs_from_its_line_farther_than_its_rows_did(rng: np.random.Generator) -> None:
    X = rng.uniform(-1.0, 1.0, (2000, 3))
    Y = np.abs(X[:, :1])
    model = LEARNERS["model-tree"].fit(X, Y, rng)
    far = model.predict(1e3 * rng.uniform(-1.0, 1.0, (100, 3)))
    slopes = LEARNERS["linear"].fit(np.eye(3), LEARNERS["linear"].fit(X, Y, rng).predict(np.eye(3)), rng)
    line = 1e3 * np.abs(slopes.predict(np.eye(3)) - slopes.predict(np.zeros((1, 3)))).sum()  # of the line, so far out
    assert np.abs(far).max() < line + 2.0


def test_what_is_taken_never_foretells_a_frame_worse_than_a_line(rng: np.random.Generator, tmp_path: Path) -> None:
    found = learn(
        recordings(rng, lag, 6, 150, 1e-3), Wishes(learners=("linear", "neighbours"), by_row=False, view="own")
    )
    line, near = found.comparison.by_run["linear"], found.comparison.by_run["neighbours"]
    assert evidence(line.by_fold, near.by_fold).gain < 0.0
    misled = replace(found.comparison, chosen="neighbours")
    learner, share, score = no_worse_than_a_line(misled, found.rows, "own", 0)
    assert evidence(line.by_fold, score.by_fold).gain >= 0.0
    assert learner.name == "linear" or share < 1.0
    between, taken, rng = (
        fitted(tempered(LEARNERS["neighbours"], 0.5), found.rows, rng, "own"),
        [],
        np.random.default_rng(0),
    )
    for name in ("linear", "neighbours"):
        taken.append(fitted(LEARNERS[name], found.rows, rng, "own").predict(found.rows.X))
    assert np.allclose(between.predict(found.rows.X), 0.5 * sum(taken), atol=1e-12)
    made = Grounding(found.rows.inputs, between, domain_of(found.rows))
    made.save(tmp_path / "grounding.npz")
    assert np.array_equal(Grounding.load(tmp_path / "grounding.npz").goal(found.rows.X), made.goal(found.rows.X))


@pytest.mark.parametrize("name", LEARNERS)
def test_a_kept_grounding_predicts_the_same(rng: np.random.Generator, tmp_path: Path, name: str) -> None:
    rows = rows_of(recordings(rng, limited, runs=2), inputs_of(recordings(rng, limited, runs=2), history=2))
    made = Grounding(rows.inputs, fitted(LEARNERS[name], rows, rng, "own"), domain_of(rows), about={"learner": name})
    made.save(tmp_path / "grounding.npz")
    read = Grounding.load(tmp_path / "grounding.npz")
    assert read.inputs == made.inputs
    assert np.array_equal(read.commands(rows.X), made.commands(rows.X))
    assert np.array_equal(read.domain.far(rows.X), made.domain.far(rows.X))


def test_another_file_is_no_grounding(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    (tmp_path / "text.npz").write_text("no archive")
    for name in ("other.npz", "text.npz", "none.npz"):
        with pytest.raises(GroundingError, match=name):
            Grounding.load(tmp_path / name)


def test_recordings_without_commands_are_named(rng: np.random.Generator) -> None:
    first, second, third = recordings(rng, runs=3)
    bare = replace(second, channels={"position": second.channel("position")})
    with pytest.raises(GroundingError, match=f"no joint of {bare.name} is commanded"):
        inputs_of([first, bare, third])


def test_the_recordings_choose_history_and_learner(rng: np.random.Generator) -> None:
    before = [np.zeros(2)]

    def late(state: Array, command: Array) -> Array:  # the command of the frame before acts
        before.append(command)
        return limited(state, before[-2])

    found = learn(recordings(rng, late, 5, 150), Wishes(learners=("linear", "model-tree"), by_row=False))
    assert found.grounding.inputs.history >= 2
    assert found.comparison.chosen == "model-tree"
    straight = learn(
        recordings(rng, lag, 5, 150, 1e-3), Wishes(learners=("linear", "model-tree", "stump"), by_row=False)
    )
    assert straight.comparison.chosen == "linear"  # nothing is surely better than a line


def test_what_is_shown_of_a_run_left_out_is_a_second_on_from_what_was_measured(rng: np.random.Generator) -> None:
    noise = 2e-3
    runs = recordings(rng, lag, 4, 300, noise)
    wishes = Wishes(learners=("linear", "simple-linear"), by_row=False, history=1)
    shown = learn(runs, wishes).shown
    assert shown.run in [r.name for r in runs]
    assert shown.time[-1] == pytest.approx(4.0 - PERIOD)
    measured = next(r for r in runs if r.name == shown.run).channel("position").values
    first = next(t for t in range(len(measured)) if np.allclose(measured[t : t + 200], shown.measured))
    # From a measured value, which is noisy, a second on by the law alone.
    state = measured[first - 1]
    for command, said in zip(shown.command[:50], shown.foretold[:50], strict=True):
        state = lag(state, command)
        assert np.abs(said - state).max() < 2.0 * noise
    assert np.ptp(shown.measured, axis=0).min() > 0.3


def test_a_share_found_by_replays_of_a_robot_that_stands_is_told_with_the_careful_choice(
    rng: np.random.Generator,
) -> None:
    runs = recordings(rng, runs=3)
    grounding = learn(runs, Wishes(learners=("linear",), by_row=False, history=1)).grounding
    leaning = [
        r.with_channel(Channel("base_orientation", ("roll", "pitch", "yaw"), "rad", r.time, np.zeros((len(r.time), 3))))
        for r in runs
    ]
    (said,) = remark_of_share(grounding.weighted(0.2, 0.8), leaning)
    assert said.startswith("0.8 of what is predicted")
    assert "--share 0.3" in said
    assert not remark_of_share(grounding.weighted(0.2, 0.8), runs)
    assert not remark_of_share(grounding.weighted(0.7, 0.3), leaning)


def test_a_centre_of_mass_from_another_origin_is_outside_of_what_was_learned(rng: np.random.Generator) -> None:
    made = []
    for run in recordings(rng, runs=8):
        height = 0.25 + 1e-3 * np.sin(7.0 * run.time) + 2e-4 * rng.standard_normal(len(run.time))
        made.append(run.with_channel(Channel("com", ("z",), "m", run.time, height[:, None])))
    learned, fresh = made[:6], made[6:]
    inputs = inputs_of(learned)
    assert inputs.others == {"com": ("z",)}
    domain, rows = domain_of(rows_of(learned, inputs)), rows_of(fresh, inputs)
    block = [b.name for b in domain.blocks].index("com")
    assert domain.far(rows.X)[:, block].mean() < 0.05
    away = np.array(rows.X)
    away[:, inputs.names.index("com.z")] += 0.036  # as far as the origins of two models of a NAO
    assert domain.far(away)[:, block].all()
    assert "com.z" in domain.reason(away[0], block, 50)


def test_folds_keep_runs_whole_and_rows_once(rng: np.random.Generator) -> None:
    rows = rows_of(recordings(rng, runs=13, frames=40), inputs_of(recordings(rng, runs=13, frames=40)))
    for folds in (folds_by_run(rows), folds_by_row(rows, rng)):
        assert np.array_equal(np.sort(np.concatenate(folds)), np.arange(len(rows.X)))
    runs = [set(rows.run[f]) for f in folds_by_run(rows)]
    assert sum(map(len, runs)) == 13


def test_wrong_names_are_told_with_the_choices(rng: np.random.Generator) -> None:
    with pytest.raises(UnknownNameError, match="model-tree"):
        learners(["modeltree"])
    with pytest.raises(UnknownNameError, match="knee"):
        inputs_of(recordings(rng), joints=["kne"])
    without = [r.without("command") for r in recordings(rng)]
    with pytest.raises(GroundingError, match="commanded are: none"):
        inputs_of(without)
