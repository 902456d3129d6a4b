# SPDX-License-Identifier: Apache-2.0
"""The whole: hidden parameters of a simulated arm from noisy logs, clocks, structure of friction, mistakes in logs."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.errors import IdentificationError, UnknownNameError
from trueup.evidence import FEWEST_PARTS
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.estimation.couplings import coupled, coupling_notes
from trueup.identification.estimation.cutoff import natural_cutoff
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.identify import Options, identify
from trueup.identification.estimation.matching import matched
from trueup.identification.estimation.motion import log_of
from trueup.identification.estimation.quick import foretelling_fit
from trueup.identification.estimation.result import Identification, relative_error
from trueup.identification.inertial import pseudo_inertia
from trueup.identification.kinematic_tree import KinematicTree, from_dh
from trueup.identification.regressors import inverse_dynamics
from trueup.recording import Channel, Recording


@pytest.fixture(scope="module")
def tree(arms: SimpleNamespace) -> KinematicTree:
    """The arm."""
    return arms.arm()


@pytest.fixture(scope="module")
def found(tree: KinematicTree, arms: SimpleNamespace) -> Identification:
    """Identified from two logs, judged on a third; the file knows no inertia."""
    rng = np.random.default_rng(0)
    runs = [arms.recording(tree, rng, f"run{k}") for k in range(3)]
    return identify(arms.without_file(tree), runs[:2], runs[2:])


def test_torque_of_another_motion_is_predicted_down_to_the_noise(found: Identification) -> None:
    assert [p.recording for p in found.held_out()] == ["run2"]
    assert relative_error(found.held_out()) < 0.01
    assert relative_error(found.held_out(), "consistent") < 1.02 * relative_error(found.held_out())


def test_hidden_base_parameters_are_recovered_within_their_deviations(
    found: Identification, tree: KinematicTree, arms: SimpleNamespace
) -> None:
    names = [*DynamicModel.of(tree, []).names, *(f"I{j + 1}m" for j in range(4))]
    values = np.concatenate([np.asarray(tree.inertial).ravel(), arms.rotors])
    truth = {name: float(value) for name, value in zip(names, values, strict=True)}
    inertial = [p for p in found.parameters if p.kind in ("inertial", "rotor")]
    errors = [abs(p.value - _group(p.name, truth)) / p.deviation for p in inertial]
    assert np.mean(np.array(errors) < 3.0) > 0.9
    strong = [p for p in inertial if p.verdict == "identified"]
    assert len(strong) >= 10
    assert all(abs(p.value / _group(p.name, truth) - 1.0) < 0.3 for p in strong)


def _group(name: str, truth: dict[str, float]) -> float:
    """The value of a readable group: 'I2zz + I2m + 0.160 m3'."""
    total, sign, factor = 0.0, 1.0, 1.0
    for word in name.split():
        if word in "+-":
            sign = 1.0 if word == "+" else -1.0
        elif word.replace(".", "", 1).replace("e-", "", 1).isdigit():
            factor = float(word)
        else:
            total += sign * factor * truth[word]
            factor = 1.0
    return total


def test_friction_is_recovered(found: Identification, arms: SimpleNamespace) -> None:
    assert found.for_file is not None
    assert np.allclose(found.for_file.friction, arms.coulomb, rtol=0.15)
    assert np.allclose(found.for_file.damping, arms.viscous, rtol=0.15)


def test_every_link_of_the_consistent_model_can_exist(found: Identification) -> None:
    assert found.for_file is not None
    for row in found.for_file.inertial:
        assert np.linalg.eigvalsh(pseudo_inertia(row))[0] > 0.0


@pytest.mark.parametrize("samples", [-4.0, 1.0, 3.0])
def test_torque_that_comes_late_is_detected_within_half_a_sample_and_set_right(
    tree: KinematicTree, samples: float, arms: SimpleNamespace
) -> None:
    rng = np.random.default_rng(2)
    late = arms.recording(tree, rng, late=samples / 200.0)
    result = identify(tree, [late], options=Options(hold_out=0.3))
    assert result.alignment is not None
    assert result.alignment.corrected
    assert result.alignment.samples == pytest.approx(samples, abs=0.5)
    assert any("was corrected" in w for w in result.warnings)
    uncorrected = identify(tree, [late], options=Options(hold_out=0.3, align="off"))
    assert relative_error(result.held_out()) < relative_error(uncorrected.held_out())


def test_torque_in_time_is_left_alone(found: Identification) -> None:
    assert found.alignment is not None
    assert not found.alignment.corrected
    assert abs(found.alignment.samples) < 0.3


def test_a_missing_structure_of_friction_is_found_by_cross_validation(
    tree: KinematicTree, arms: SimpleNamespace
) -> None:
    rng = np.random.default_rng(3)
    runs = [arms.recording(tree, rng, f"r{k}", quadratic=0.8) for k in range(2)]
    chosen, common = (
        identify(tree, runs[:1], runs[1:], options=Options(structure=s, consistent=False)) for s in ("select", "common")
    )
    assert relative_error(chosen.held_out()) < 0.7 * relative_error(common.held_out())


def test_without_anything_held_out_the_result_says_so_loudly(tree: KinematicTree, arms: SimpleNamespace) -> None:
    result = identify(tree, [arms.recording(tree, np.random.default_rng(4))], options=Options(consistent=False))
    assert result.held_out() == []
    assert any("nothing was held out" in w for w in result.warnings)


def test_what_was_not_seen_is_named_with_a_motion_that_would_show_it(
    tree: KinematicTree, arms: SimpleNamespace
) -> None:
    slow = arms.recording(tree, np.random.default_rng(5), size=0.12, noise=2.0)
    result = identify(tree, [slow], options=Options(hold_out=0.3, consistent=False))
    assert any(p.verdict == "not seen" for p in result.parameters)
    assert any(
        "not seen" in sentence and ("Accelerate" in sentence or "Turn" in sentence) for sentence in result.advice
    )


def _changed(r: Recording, name: str, order: list[int] | None = None, factor: float = 1.0) -> Recording:
    channel = r.channel(name)
    values = channel.values if order is None else channel.values[:, order]
    return r.with_channel(channel.replace(values=factor * values))


def test_degrees_are_named(tree: KinematicTree, arms: SimpleNamespace) -> None:
    r = _changed(arms.recording(tree, np.random.default_rng(6), size=2.0), "position", factor=180.0 / np.pi)
    with pytest.raises(IdentificationError, match=r'unit = "deg"'):
        identify(tree, [r])


@pytest.mark.parametrize(("turned", "unit"), [(1.0, "rad"), (180.0 / np.pi, "deg")])
def test_a_slide_in_mm_is_named_with_the_units_of_all_joints(
    tree: KinematicTree, arms: SimpleNamespace, turned: float, unit: str
) -> None:
    slides = np.array([False, False, True, False])
    scara = tree.replace(prismatic=slides, lower=np.full(4, -2.0), upper=np.full(4, 2.0))
    r = arms.recording(scara, np.random.default_rng(6), size=1.0)
    channel = r.channel("position")
    r = r.with_channel(channel.replace(values=channel.values * np.where(slides, 1e3, turned), units=()))
    with pytest.raises(IdentificationError, match=rf'units = \["{unit}", "{unit}", "mm", "{unit}"\]'):
        identify(scara, [r])


def test_exchanged_torques_are_named(tree: KinematicTree, arms: SimpleNamespace) -> None:
    r = _changed(arms.recording(tree, np.random.default_rng(7)), "torque", order=[0, 2, 1, 3])
    with pytest.raises(IdentificationError, match="joint2 and joint3 seem to be exchanged"):
        identify(tree, [r])


def test_what_a_short_log_explains_it_need_not_foretell(tree: KinematicTree, arms: SimpleNamespace) -> None:
    rng, drives = np.random.default_rng(7), Drives.direct(tree.joints)
    motion = log_of(arms.recording(tree, rng), tree, drives).motion(10.0, measured_speed=False)
    chance = replace(motion, torque=np.cumsum(rng.standard_normal(motion.torque.shape), axis=0))
    fit = foretelling_fit(motion, tree, drives, 10.0, parts=(1, FEWEST_PARTS))
    sound, none = ([float(np.sqrt(x.sum())) for x in fit(each)] for each in (motion, chance))
    assert sound[0] < sound[1] < 1.3 * sound[0]
    assert none[1] > 1.3 * none[0]


@pytest.mark.parametrize("seed", [3, 4, 5])
@pytest.mark.parametrize("seconds", [4.0, 5.0])
def test_a_sound_log_is_not_refused_for_being_short_and_unlike_any_rigid_arm(
    arms: SimpleNamespace, seed: int, seconds: float
) -> None:
    tree, rng = arms.arm(seed), np.random.default_rng(seed)
    time = np.arange(round(200.0 * seconds)) / 200.0
    q, v, a = arms.sines(rng, time, 4, size=0.3)
    rippling = arms.torque(tree, q, v, a) + 2.0 * arms.coulomb * np.sin(60.0 * q)
    channels = {
        "position": Channel("position", tree.joints, "rad", time, q + 2e-5 * rng.normal(size=q.shape)),
        "torque": Channel("torque", tree.joints, "N m", time, rippling + 0.5 * rng.normal(size=q.shape)),
    }
    found = identify(arms.without_file(tree), [Recording("short", channels)], options=Options(consistent=False))
    assert found.joints == tree.joints


@pytest.mark.parametrize("order", [[1, 0, 2, 3], [0, 3, 2, 1], [3, 2, 1, 0]])
def test_joints_in_another_order_are_named(tree: KinematicTree, arms: SimpleNamespace, order: list[int]) -> None:
    r = arms.recording(tree, np.random.default_rng(7))
    mixed = _changed(_changed(r, "position", order=order), "torque", order=order)
    with pytest.raises(IdentificationError, match=r"seem to be exchanged|in reverse order"):
        identify(tree, [mixed])


def test_a_wrong_sign_is_named(tree: KinematicTree, arms: SimpleNamespace) -> None:
    r = arms.recording(tree, np.random.default_rng(8))
    flipped = r.channel("torque").values * np.array([1.0, -1.0, 1.0, 1.0])
    with pytest.raises(IdentificationError, match="torque of joint2 seems to have the wrong sign"):
        identify(tree, [r.with_channel(r.channel("torque").replace(values=flipped))])


def test_a_torque_without_a_unit_is_taken_as_newton_metres_and_that_is_said(
    tree: KinematicTree, arms: SimpleNamespace
) -> None:
    r = arms.recording(tree, np.random.default_rng(9))
    bare = [r.with_channel(r.channel("torque").replace(unit="")), r.replace(name="second")]
    found = identify(tree, bare, options=Options(consistent=False))
    assert sum("in which unit torque is" in said for said in found.warnings) == 1


def test_a_torque_without_gravity_is_named(tree: KinematicTree, arms: SimpleNamespace) -> None:
    r = arms.recording(tree, np.random.default_rng(6), size=2.0)
    q = r.channel("position").values
    held = inverse_dynamics(tree, np.asarray(tree.inertial), q, np.zeros_like(q), np.zeros_like(q))
    without = r.with_channel(r.channel("torque").replace(values=r.channel("torque").values - held))
    with pytest.raises(IdentificationError, match=r"no gravity.*--gravity 0 0 0"):
        identify(tree, [without])
    found = identify(tree.replace(gravity=np.zeros(3)), [without], options=Options(hold_out=0.3))
    assert relative_error(found.held_out()) < 0.1


def test_wrong_signs_are_named_where_friction_is_most_of_the_torque(tree: KinematicTree, arms: SimpleNamespace) -> None:
    r = arms.recording(tree, np.random.default_rng(8), size=2.0)
    v = np.gradient(r.channel("position").values, r.channel("position").time, axis=0)
    heavy = r.channel("torque").values + 12.0 * arms.coulomb * np.tanh(v / 0.3)
    flipped = r.with_channel(r.channel("torque").replace(values=heavy * [-1.0, 1.0, 1.0, -1.0]))
    with pytest.raises(IdentificationError, match="of joint1, joint4 seems to have the wrong sign"):
        identify(tree, [flipped])


@pytest.mark.parametrize(
    ("channel", "sign", "said"),
    [
        ("torque", [-1, 1, 1, -1], "of joint1, joint4 seems to have the wrong sign"),
        ("torque", [-1, -1, -1, -1], "the torque of joint1, joint2, joint3, joint4 seems to have the wrong sign"),
        ("position", [1, -1, -1, 1], "position of joint2, joint3 seems to have the wrong sign"),
    ],
)
def test_friction_that_would_drive_joints_gives_all_their_wrong_signs_away(
    tree: KinematicTree, arms: SimpleNamespace, channel: str, sign: list[int], said: str
) -> None:
    r = arms.recording(tree, np.random.default_rng(8))
    flipped = r.channel(channel).replace(values=r.channel(channel).values * np.array(sign))
    with pytest.raises(IdentificationError, match=said):
        identify(tree, [r.with_channel(flipped)], options=Options(consistent=False))


def test_thousandths_of_newton_metres_are_named(tree: KinematicTree, arms: SimpleNamespace) -> None:
    with pytest.raises(IdentificationError, match=r'unit = "mN m"'):
        identify(tree, [_changed(arms.recording(tree, np.random.default_rng(9)), "torque", factor=1e3)])


def test_a_current_without_a_unit_is_not_said_to_be_in_amperes(tree: KinematicTree, arms: SimpleNamespace) -> None:
    log = arms.recording(tree, np.random.default_rng(9))
    log = log.without("torque").with_channel(log.channel("torque").replace(name="current", unit=""))
    known = replace(Drives.direct(tree.joints), known_constants=tuple(tree.joints))
    plain, scaled = (log_of(log, tree, drives) for drives in (Drives.direct(tree.joints), known))
    assert (plain.units, plain.notes) == (("units of current",) * tree.n, ())
    assert (scaled.units, len(scaled.notes)) == (("N m",) * tree.n, 1)
    assert "nothing says in which unit current is; it was taken as A" in scaled.notes[0]


def test_currents_in_thousandths_are_named_as_currents(tree: KinematicTree, arms: SimpleNamespace) -> None:
    log = _changed(arms.recording(tree, np.random.default_rng(9)), "torque", factor=1e3)
    log = log.without("torque").with_channel(log.channel("torque").replace(name="current", unit="A"))
    known = replace(Drives.direct(tree.joints), known_constants=tuple(tree.joints))
    with pytest.raises(IdentificationError, match=r'logged in mA, say unit = "mA".*ratio and torque_constant'):
        identify(tree, [log], drives=known)


def test_a_log_without_motion_is_refused_with_what_to_do(tree: KinematicTree, arms: SimpleNamespace) -> None:
    with pytest.raises(IdentificationError, match=r"no joint moves.*trueup excite"):
        identify(tree, [arms.recording(tree, np.random.default_rng(10), size=1e-3)])


def test_a_log_without_torque_is_refused_with_its_channels(tree: KinematicTree, arms: SimpleNamespace) -> None:
    with pytest.raises(IdentificationError, match=r"no channel 'torque' or 'current'.*its channels are: position"):
        identify(tree, [arms.recording(tree, np.random.default_rng(11)).without("torque")])


def test_unknown_joints_are_refused_and_numbered_ones_taken_in_order_with_a_note(
    tree: KinematicTree, arms: SimpleNamespace
) -> None:
    r = arms.recording(tree, np.random.default_rng(12))
    numbered = r.rename({j: f"axis_{k + 1}" for k, j in enumerate(tree.joints)})
    same, (runs, _), notes = matched(tree, ([numbered], []))
    assert runs[0].channel("torque").labels == tree.joints
    assert same.n == tree.n
    assert "nothing here can prove" in notes[0]
    with pytest.raises(UnknownNameError, match="position columns of the logs"):
        matched(tree, ([r.rename(dict(zip(tree.joints, "abcd", strict=True)))], []))


def test_joints_are_matched_whatever_all_names_begin_or_end_with_and_each_channel_by_itself(
    tree: KinematicTree, arms: SimpleNamespace
) -> None:
    r = arms.recording(tree.replace(joints=("base", "shoulder", "elbow", "wrist")), np.random.default_rng(12))
    named = tree.replace(joints=r.channel("torque").labels)
    torque = r.channel("torque").replace(labels=("joint_1", "joint_2", "joint_3", "joint_4"))
    decorated = r.rename({j: f"motor_{j}_act" for j in named.joints}).with_channel(torque)
    _, (runs, _), notes = matched(named, ([decorated], []))
    assert runs[0].channel("position").labels == runs[0].channel("torque").labels == named.joints
    assert notes == ()


def test_joints_that_no_log_has_are_locked(tree: KinematicTree, arms: SimpleNamespace) -> None:
    r = arms.recording(tree, np.random.default_rng(13))
    part = r.replace(channels={k: c.select(tree.joints[:3]) for k, c in r.channels.items()})
    smaller, _, notes = matched(tree, ([part], []))
    assert smaller.joints == tree.joints[:3]
    assert "locked" in notes[0]


def test_an_endless_joint_that_jumps_by_a_turn_is_taken_as_going_on(tree: KinematicTree, arms: SimpleNamespace) -> None:
    r = arms.recording(tree, np.random.default_rng(14), size=3.0)
    wound = np.mod(r.channel("position").values + np.pi, 2.0 * np.pi) - np.pi
    jumping = r.with_channel(r.channel("position").replace(values=wound))
    plain, unwound = (identify(tree, [x], options=Options(hold_out=0.3, consistent=False)) for x in (r, jumping))
    assert relative_error(unwound.held_out()) == pytest.approx(relative_error(plain.held_out()), rel=0.05)
    assert any("jumps by a turn" in w for w in unwound.warnings)


def test_a_hole_in_the_log_is_neither_fitted_nor_judged(tree: KinematicTree, arms: SimpleNamespace) -> None:
    r = arms.recording(tree, np.random.default_rng(15))
    keep = (r.time < 5.0) | (r.time > 8.0)
    holed = r.replace(channels={k: c.replace(time=c.time[keep], values=c.values[keep]) for k, c in r.channels.items()})
    result = identify(tree, [holed], options=Options(hold_out=0.3, consistent=False))
    assert not any(np.any((p.time > 5.0) & (p.time < 8.0)) for p in result.predictions)
    assert relative_error(result.held_out()) < 0.02


def test_an_arm_on_a_wall_is_recognised(tree: KinematicTree, arms: SimpleNamespace) -> None:
    mounted = tree.replace(gravity=np.array([9.81, 0.0, 0.0]))
    r = arms.recording(mounted, np.random.default_rng(16), noise=0.1)
    with pytest.raises(IdentificationError, match=r"--gravity 9\.81 0 0"):
        identify(tree, [r])
    assert relative_error(identify(mounted, [r], options=Options(hold_out=0.3, consistent=False)).held_out()) < 0.02


def test_an_arm_on_a_slope_is_recognised_and_the_slope_nearly_found(tree: KinematicTree, arms: SimpleNamespace) -> None:
    mounted = tree.replace(gravity=9.81 * np.array([np.sin(0.5), 0.0, -np.cos(0.5)]))
    with pytest.raises(IdentificationError, match="--gravity") as error:
        identify(tree, [arms.recording(mounted, np.random.default_rng(16), noise=0.1)])
    found = np.array([float(x) for x in str(error.value).split("--gravity ")[1].split(",")[0].split()])
    assert found @ mounted.gravity / 9.81**2 > np.cos(0.12)


def _loaded(
    tree: KinematicTree, arms: SimpleNamespace, seed: int, gains: NDArray[np.float64], share: float
) -> Recording:
    """A log of an arm whose gears rub the more the more torque they carry, torques in units of the drives' own."""
    rng, time = np.random.default_rng(seed), np.arange(4000) / 200.0
    q, v, a = arms.sines(rng, time, tree.n)
    carried = inverse_dynamics(tree, np.asarray(tree.inertial), q, v, a)
    torque = arms.torque(tree, q, v, a) + share * np.abs(carried) * np.tanh(v / 0.02)
    channels = {
        "position": Channel("position", tree.joints, "rad", time, q + 2e-5 * rng.normal(size=q.shape)),
        "torque": Channel("torque", tree.joints, "N m", time, (torque + 0.1 * rng.normal(size=q.shape)) / gains),
    }
    return Recording(f"loaded{seed}", channels)


def test_friction_that_grows_with_the_load_is_found(tree: KinematicTree, arms: SimpleNamespace) -> None:
    runs = [_loaded(tree, arms, seed, np.ones(4), 0.08) for seed in (1, 2, 3)]
    found, common = (
        identify(arms.without_file(tree), runs[:2], runs[2:], options=Options(structure=s, consistent=False))
        for s in ("select", "common")
    )
    shares = [p.value for p in found.parameters if p.kind == "load"]
    assert len(shares) >= 2
    assert np.allclose(shares, 0.08, atol=0.03)
    assert relative_error(found.held_out()) < 0.5 * relative_error(common.held_out())


def test_torques_out_of_scale_with_one_another_are_still_predicted(tree: KinematicTree, arms: SimpleNamespace) -> None:
    gains = np.array([1.0, 0.7, 1.3, 0.8])
    runs = [_loaded(tree, arms, seed, gains, 0.0) for seed in (1, 2, 3)]
    found, common = (
        identify(
            arms.without_file(tree), runs[:2], runs[2:], options=Options(structure=s, consistent=False, gains=True)
        )
        for s in ("select", "common")
    )
    assert relative_error(found.held_out()) < 0.6 * relative_error(common.held_out())


@pytest.mark.parametrize("noise", [1e-3, 4e-3])
def test_noise_of_positions_is_not_taken_for_motion(tree: KinematicTree, arms: SimpleNamespace, noise: float) -> None:
    r = arms.recording(tree, np.random.default_rng(17))
    q = r.channel("position")
    noisy = r.with_channel(q.replace(values=q.values + noise * np.random.default_rng(1).normal(size=q.values.shape)))
    clean, found = (natural_cutoff([log_of(x, tree, Drives.direct(tree.joints))]) for x in (r, noisy))
    assert found <= 1.3 * clean


def test_accelerations_that_are_noise_are_cut_off_however_fast_the_ends_of_a_log_seem() -> None:
    time = np.arange(800) / 100.0
    slow = 0.4 * np.sin(2.0 * np.pi * np.array([0.17, 0.21, 0.23, 0.29]) * time[:, None])  # cut on the move
    noise = np.random.default_rng(1).normal(size=slow.shape)
    logs: list[Any] = [SimpleNamespace(position=slow + n * noise, rate=100.0, gaps=()) for n in (2e-5, 1e-3)]
    clean, found = (natural_cutoff([log]) for log in logs)
    assert clean >= 10.0, "the jump from one end to the other counts as fast motion"
    assert 5.0 <= found < 0.7 * clean


@pytest.mark.parametrize(
    ("ratios", "rotor"),
    [((0.0, 0.8, 0.0), 1.0), ((0.0, 1.0, 0.0), 1.0), ((0.2, 0.6, 0.1), 1.0), ((0.3, -0.5, 0.2), 0.0), ((0, 0, 0), 1.0)],
)
def test_the_couplings_of_a_wrist_are_found_by_rotors_and_friction_or_friction_alone(
    arms: SimpleNamespace, ratios: tuple[float, float, float], rotor: float
) -> None:
    rng = np.random.default_rng(3)
    half = np.pi / 2
    tree = from_dh(
        a=[0.1, 0.5, 0.1, 0.0, 0.0], alpha=[half, 0.0, half, -half, 0.0], d=[0.4, 0.0, 0.0, 0.4, 0.1], name="wrist",
        inertial=arms.bodies(rng, np.array([12.0, 8.0, 4.0, 1.5, 0.5])),
    )  # fmt: skip
    time = np.arange(6000) / 200.0
    q, v, a = arms.sines(rng, time, 5)
    C = np.eye(5)
    C[3, 2], C[4, 3], C[4, 2] = ratios
    rubbing = 0.1 * np.array([40.0, 40.0, 15.0, 8.0, 6.0]) * (np.tanh(v @ C.T / 0.02) + 0.5 * v @ C.T)
    torque = inverse_dynamics(tree, np.asarray(tree.inertial), q, v, a) + (0.05 * rotor * a @ C.T + rubbing) @ C
    channels = {
        "position": Channel("position", tree.joints, "rad", time, q + 2e-5 * rng.normal(size=q.shape)),
        "torque": Channel("torque", tree.joints, "N m", time, torque + 0.05 * rng.normal(size=q.shape)),
    }
    log = log_of(Recording("run", channels), tree, Drives.direct(tree.joints))
    motions = [log.motion(5.0, measured_speed=False)]
    drives = Drives.direct(tree.joints)
    found = coupled(motions, tree, drives, 5.0, 0.0)
    np.testing.assert_allclose(found.coupling, C, atol=0.03)
    assert len(coupling_notes(found, drives)) == np.count_nonzero(ratios)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_short_slow_log_predicts_faster_wider_and_slower_motion_better_than_plain_least_squares(
    arms: SimpleNamespace, seed: int
) -> None:
    tree, rng = arms.arm(seed), np.random.default_rng(seed)
    plans = (("short", 8.0, 0.4), ("wide and fast", 15.0, 0.9), ("slow", 15.0, 0.15))
    runs = [arms.recording(tree, rng, name, seconds=seconds, size=size) for name, seconds, size in plans]
    ours = identify(arms.without_file(tree), runs[:1], runs[1:])
    plain = Options(structure="common", consistent=False, cutoff=ours.cutoff)
    peer = identify(arms.without_file(tree), runs[:1], runs[1:], options=plain)
    for mine, theirs in zip(ours.held_out(), peer.held_out(), strict=True):
        assert relative_error([mine]) < 0.7 * relative_error([theirs])
