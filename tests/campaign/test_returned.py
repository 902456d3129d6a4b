# SPDX-License-Identifier: Apache-2.0
"""What a driver hands back is in SI and is the run that was asked for, before anything is scored or calibrated by it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trueup.campaign.campaign import Campaign
from trueup.campaign.events import Scored, TrialDone, TrialStarted
from trueup.campaign.folder import Folder
from trueup.campaign.journal import Journal, read_journal
from trueup.campaign.plan import read_plan
from trueup.campaign.resolve import parts_of
from trueup.campaign.returned import as_asked
from trueup.ends import Ended, with_end
from trueup.errors import RecordingError, TrialError
from trueup.recording import Channel, Recording
from trueup.trial import Observed, Trial

Write = Callable[..., Path]
Change = Callable[[Recording], Recording]


class Driver:
    """The toy's robot, whose recordings a driver makes something else of."""

    repeatable = True

    def __init__(self, robot: object, change: Change) -> None:
        self._robot, self._change = robot, change

    def perform(self, trial: Trial) -> list[Recording]:
        return [self._change(r) for r in self._robot.perform(trial)]  # type: ignore[attr-defined]


def run(plan: Path, out: Path, change: Change) -> Sequence[object]:
    folder = Folder.begin(read_plan(plan), out, None)
    parts = parts_of(folder.file, folder.path, lambda line: None)
    with Journal(folder.path) as journal:
        made = replace(parts, robot=Driver(parts.robot, change))
        Campaign(folder.file.plan, folder.checksum, "0", made, journal, None).run()
    return read_journal(folder.path)


def timed(recording: Recording, factor: float) -> Recording:
    return recording.replace(channels={n: c.replace(time=c.time * factor) for n, c in recording.channels.items()})


def in_millimetres(recording: Recording) -> Recording:
    place = recording.channel("position")
    return recording.with_channel(place.replace(unit="mm", values=1000.0 * place.values))


def in_degrees(recording: Recording) -> Recording:
    return recording.with_channel(recording.channel("position").replace(unit="deg"))


def none_at_all(recording: Recording) -> Recording:
    return recording.with_channel(recording.channel("position").replace(values=np.zeros((0, 1)), time=np.zeros(0)))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda r: r.slice(r.start, r.start + 1.5), "lasts 1.48 s of 4 s without an end"),
        (lambda r: timed(r, 1000.0), r"its clock is in another unit \(ms\): channels have their time in s"),
        (in_degrees, "has channel 'position' in rad, where m is observed"),
        (none_at_all, "is no recording: channel 'position' has no samples"),
    ],
)
def test_what_is_not_the_run_asked_for_stops_a_campaign_at_its_first_trial(
    write_plan: Write, tmp_path: Path, change: Change, said: str
) -> None:
    plan, out = write_plan(("rounds = 2", "rounds = 1")), tmp_path / "out"
    with pytest.raises(TrialError, match=f"trial-001: .*{said}") as error:
        run(plan, out, change)
    assert not isinstance(error.value, RecordingError)
    assert "Mend the driver; `trueup resume` goes on from here" in str(error.value)
    assert isinstance(read_journal(out)[-1], TrialStarted)
    assert any(isinstance(e, TrialDone) for e in run(plan, out, lambda r: r))  # mended


def test_a_driver_may_measure_in_any_unit_that_it_names(write_plan: Write, tmp_path: Path) -> None:
    plan = write_plan(("rounds = 2", "rounds = 1"))
    plain, others = (
        [e.scores for e in run(plan, tmp_path / name, change) if isinstance(e, Scored)]
        for name, change in (("plain", lambda r: r), ("mm", in_millimetres))
    )
    np.testing.assert_allclose(others, plain, rtol=1e-9)


def sent(labels: tuple[str, ...] = ("a", "b")) -> tuple[Trial, Recording]:
    """A trial whose command is known, and what a driver measured of it, on a clock of its own."""
    time = np.arange(0.0, 3.0, 0.01)
    asked = np.stack([np.sin(2.0 * time), np.sin(5.0 * time + 1.0)], axis=1)
    trial = Trial("move", 0.0, 2.99, Channel("command", ("a", "b"), "rad", time, asked),
                  {"position": Observed(("a", "b"), "rad", time)})  # fmt: skip
    return trial, Recording("run", {"position": Channel("position", labels, "rad", time + 100.0, 0.9 * asked)})


def test_a_command_that_a_driver_does_not_log_is_the_one_that_was_requested() -> None:
    trial, measured = sent()
    (recording,) = as_asked(trial, [measured])
    command = recording.channel("command")
    assert command.time[0] == pytest.approx(100.0)
    np.testing.assert_array_equal(command.values, trial.command.values if trial.command else None)


def test_quaternions_of_a_base_are_the_angles_that_are_observed() -> None:
    trial, measured = sent()
    turned = 0.3 * np.sin(measured.time)
    angles = Observed(("roll", "pitch", "yaw"), "rad", trial.observed["position"].time)
    half = np.stack([np.cos(turned / 2), 0 * turned, np.sin(turned / 2), 0 * turned], axis=1)  # about y
    tracked = Channel("base_orientation", ("w", "x", "y", "z"), "", measured.time, half)
    asked = replace(trial, observed={**trial.observed, "base_orientation": angles})
    (recording,) = as_asked(asked, [measured.with_channel(tracked)])
    pitch = recording.channel("base_orientation").column("pitch")
    np.testing.assert_allclose(pitch, turned, atol=1e-9)


def test_a_clock_in_ms_is_named_where_the_command_is_by_it_too() -> None:
    trial, measured = sent()
    assert trial.command is not None
    with pytest.raises(TrialError, match="its clock is in another unit"):
        as_asked(trial, [timed(measured.with_channel(trial.command.replace(time=measured.time)), 1000.0)])


def test_a_fall_after_a_sixtieth_of_a_run_is_no_clock_in_minutes() -> None:
    trial, measured = sent()
    fell = with_end(measured.slice(measured.start, measured.start + 0.05), Ended(measured.start + 0.05, "fallen"))
    (recording,) = as_asked(trial, [fell])
    assert len(recording.channel("position").time) == 6
    with pytest.raises(TrialError, match=r"its clock is in another unit \(min\)"):
        as_asked(trial, [with_end(timed(measured, 1.0 / 60.0), Ended(measured.stop / 60.0, "fallen"))])


def test_joints_in_another_order_than_their_labels_are_named() -> None:
    trial, measured = sent(("b", "a"))
    with pytest.raises(TrialError, match=r"the position of 'a' follows what was asked of 'b'.*order of the columns"):
        as_asked(trial, [measured])


def test_positions_in_degrees_that_are_called_radians_are_named() -> None:
    trial, measured = sent()
    place = measured.channel("position")
    with pytest.raises(TrialError, match=r"of a, b is about 0.0175 times position.*position in degrees"):
        as_asked(trial, [measured.with_channel(place.replace(values=np.degrees(place.values)))])
