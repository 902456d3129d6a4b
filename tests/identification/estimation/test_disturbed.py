# SPDX-License-Identifier: Apache-2.0
"""What acted on an arm and is in no model of it is named and left out; what a model does badly throughout is not."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.errors import TrueupError
from trueup.identification.estimation.disturbed import _looked
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.identify import Options, identify
from trueup.identification.estimation.motion import log_of
from trueup.identification.estimation.result import relative_error
from trueup.identification.regressors import inverse_dynamics
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]
FAST = Options(consistent=False, structure="common")
PUSHED = ((2.0, 3.0), (6.5, 7.2), (9.0, 10.5))


def runs(arms: SimpleNamespace, count: int) -> list[Recording]:
    return [
        arms.recording(arms.arm(), np.random.default_rng(20 + k), f"run{k}", seconds=12.0, noise=0.1)
        for k in range(count)
    ]


def pushed(recording: Recording, size: float) -> Recording:
    """The log with torque of something that pushed the arm three times."""
    torque = recording.channel("torque")
    push = np.zeros(len(torque.time))
    for first, last in PUSHED:
        inside = (torque.time > first) & (torque.time < last)
        push[inside] += np.sin(np.pi * (torque.time[inside] - first) / (last - first))
    values = torque.values + size * push[:, None] * np.array([1.0, -0.8, 0.5, 0.1])
    return recording.with_channel(torque.replace(values=values))


def moved(arms: SimpleNamespace, name: str, q: Array, time: Array, held: Array) -> Recording:
    """The log of any motion, with a share of Coulomb friction (S, n) in place of what sets in with speed."""
    tree, v = arms.arm(), np.gradient(q, time, axis=0)
    a = np.gradient(v, time, axis=0)
    torque = inverse_dynamics(tree, np.asarray(tree.inertial), q, v, a) + arms.rotors * a + arms.viscous * v
    noise = 0.05 * np.random.default_rng(0).normal(size=q.shape)
    return Recording(
        name,
        {
            "position": Channel("position", tree.joints, "rad", time, q),
            "torque": Channel("torque", tree.joints, "N m", time, torque + arms.coulomb * held + noise),
        },
    )


def told(found: object) -> list[str]:
    return [w for w in found.warnings if "something acted on the arm" in w]  # type: ignore[attr-defined]


def test_stretches_in_which_an_arm_was_pushed_are_named_and_left_out(arms: SimpleNamespace) -> None:
    *logs, judged = runs(arms, 3)
    hit = [pushed(log, 40.0) for log in logs]
    found = identify(arms.arm(), hit, [judged], options=FAST)
    (said,) = told(found)
    assert "left out" in said
    for name in ("run0", "run1"):
        spans = re.findall(r"(\S+) \.\.\. (\S+) s", said.split(f"'{name}'")[1].split(";")[0])
        assert len(spans) == len(PUSHED)
        for (first, last), (begin, end) in zip(PUSHED, spans, strict=True):
            assert first - 1.0 < float(begin) < first + 0.2
            assert last - 0.2 < float(end) < last + 1.0
    alone = relative_error(identify(arms.arm(), logs, [judged], options=FAST).held_out())
    assert relative_error(found.held_out()) < 1.2 * alone
    kept = identify(
        arms.arm(), hit, [judged], options=Options(consistent=False, structure="common", refuse=("disturbed",))
    )
    assert told(kept)[0].startswith("refused")
    assert relative_error(kept.held_out()) > 3.0 * alone


def test_a_push_in_a_log_that_judges_is_left_out_there(arms: SimpleNamespace) -> None:
    *logs, judged = runs(arms, 3)
    found = identify(arms.arm(), logs, [pushed(judged, 40.0)], options=FAST)
    (said,) = told(found)
    assert "'run2'" in said
    assert "'run0'" not in said
    assert relative_error(found.held_out()) < 0.02


def test_friction_that_holds_an_arm_between_its_moves_acts_from_within(arms: SimpleNamespace) -> None:
    rng, time = np.random.default_rng(3), np.arange(0.0, 20.0, 0.005)
    q, now, begin = np.zeros((len(time), 4)), np.zeros(4), 0.5
    held = np.zeros_like(q)
    while begin < time[-1]:
        to, long = rng.uniform(-1.0, 1.0, 4), float(rng.uniform(0.8, 1.6))
        u = np.clip((time - begin) / long, 0.0, 1.0)
        q = np.where((time >= begin)[:, None], now + (to - now) * (u**3 * (10 - 15 * u + 6 * u**2))[:, None], q)
        # It comes to rest with what friction happens to hold of the load.
        rest, share = (time >= begin + long)[:, None], rng.uniform(-1.0, 1.0, 4)
        held = np.where((time >= begin)[:, None], np.where(rest, share, np.sign(to - now)), held)
        now, begin = to, begin + long + float(rng.uniform(0.3, 1.2))
    assert not told(identify(arms.arm(), [moved(arms, "moves", q, time, held)], options=FAST))


def test_motion_that_is_fast_once_is_no_push(arms: SimpleNamespace) -> None:
    time = np.arange(0.0, 30.0, 0.005)
    phase = np.interp(time, [0.0, 14.0, 15.0, 18.0, 19.0, 30.0], [0.0, 3.0, 4.0, 12.0, 13.0, 16.0])
    phase = np.convolve(np.pad(phase, 100, mode="edge"), np.full(201, 1.0 / 201), mode="valid")
    w = np.random.default_rng(4).uniform(0.4, 1.3, (3, 4))
    q = 0.4 * np.sin(w * phase[:, None, None] + w[::-1] * 5.0).sum(axis=1)
    v = np.gradient(q, time, axis=0)
    fades = np.sign(v) * (1.0 + 0.6 * np.exp(-((v / 0.15) ** 2))) + 0.3 * v * np.abs(v)  # which no basic model has
    assert not told(identify(arms.arm(), [moved(arms, "burst", q, time, fades)], options=FAST))


def test_what_may_not_be_refused_is_an_error(arms: SimpleNamespace) -> None:
    with pytest.raises(TrueupError, match="disturbed"):
        identify(arms.arm(), runs(arms, 1), options=Options(refuse=("disturbd",)))


def test_what_is_off_everywhere_stands_out_from_nothing(arms: SimpleNamespace) -> None:
    tree = arms.arm()
    drives = Drives.direct(tree.joints)
    looked = _looked([log_of(r, tree, drives) for r in runs(arms, 2)], tree, drives)
    assert looked is not None
    off = [np.full(len(p.time), 99.0) for p in looked.parts]
    assert looked._beyond(off, 5.0) == ([], 99.0)
