# SPDX-License-Identifier: Apache-2.0
"""Is a log what was asked for? Channels, joints and their order, duration, clock, the command; of a vehicle the drive."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.inspection.asked import Unlike, lasting, missized, sized, swapped
from trueup.inspection.requested import completed, side_by_side
from trueup.inspection.standing import standing
from trueup.inspection.unmeasured import unmeasured
from trueup.recording import Channel, Recording, is_command
from trueup.robots.by_hand.drive import unlike_a_vehicle, unlike_its_path
from trueup.rounding import ROUNDED
from trueup.samples import rms
from trueup.trial import Trial

_SAME_COMMAND = 0.15  # root mean square difference from what was asked, as a share of its spread


def mismatches(trial: Trial, recording: Recording) -> list[str]:
    """What is not as asked for, one sentence each with what mends it; [] for a log that can be used."""
    found = _channels(trial, recording)
    if found:
        return found
    found = (
        _mended(lasting(trial, recording) or sized(trial, recording), trial)
        or _missing(trial, recording)
        or _stood(trial, recording)
    )
    if found:
        return found
    return _commands(trial, recording) + unlike_its_path(trial, recording) + unlike_a_vehicle(trial, recording)


def _channels(trial: Trial, recording: Recording) -> list[str]:
    found = []
    if lost := [f"'{name}'" for name in trial.observed if not recording.has(name)]:
        names = " or ".join(filter(None, (", ".join(lost[:-1]), lost[-1])))
        has = ", ".join(_words(c) for c in recording.channels.values())
        found.append(f"there is no channel {names} in it; it holds {has}: a wrong file, or mapping.toml must say where")
    for name, o in ((n, o) for n, o in trial.observed.items() if recording.has(n)):
        channel = recording.channel(name)
        missing = [label for label in o.labels if label not in channel.labels]
        if missing:
            found.append(
                f"channel '{name}' lacks {', '.join(missing)}; it has {', '.join(channel.labels)}: give the joints their "
                "names in mapping.toml (labels, or [joints])"
            )
        elif o.unit and channel.unit and o.unit != channel.unit:
            found.append(f"channel '{name}' is in {channel.unit}, asked for in {o.unit}: say the unit in mapping.toml")
    return found


def _words(channel: Channel) -> str:
    """A channel with its labels, where these say more than its name."""
    return channel.name if channel.labels == (channel.name,) else f"{channel.name} ({', '.join(channel.labels)})"


def _mended(unlike: Unlike | None, trial: Trial) -> list[str]:
    """What is unlike what was asked for, with what an operator does about it."""
    if unlike is None:
        return []
    mends = {
        "instant": "",
        "clock": "; say it in mapping.toml, [time], unit",
        "short": f": still being written, or broken off? If the run was stopped, put {trial.name}-aborted.txt beside it",
        "long": ": does it hold two runs? cut out the right one",
        "order": "; give the columns their right labels in mapping.toml",
        "unit": "; say the unit of the log in mapping.toml, or in the names of its columns",
    }
    return [unlike.words + mends[unlike.kind]]


def _missing(trial: Trial, recording: Recording) -> list[str]:
    """What is observed was measured all along, from where the run begins."""
    return [
        f"{words}, so nobody can say what the robot did there: run it again, or put {trial.name}-aborted.txt beside it"
        for words in unmeasured(trial, completed(trial, recording))
    ]


def _stood(trial: Trial, recording: Recording) -> list[str]:
    words = standing(trial, recording)
    return [f"{words}: run it again, or put {trial.name}-aborted.txt beside it"] if words else []


def _commands(trial: Trial, recording: Recording) -> list[str]:
    """The command recorded is the one requested; where none was recorded, the joints follow it in the right order."""
    asked = trial.command
    if asked is None:
        return []
    for name in ("command", "command_sent"):
        if recording.has(name):
            done = recording.channel(name)
            labels = [label for label in asked.labels if label in done.labels]
            if len(labels) < len(asked.labels):
                lost = [label for label in asked.labels if label not in labels]
                return [
                    f"channel '{name}' lacks {', '.join(lost)}, which were commanded; it has {', '.join(done.labels)}"
                ]
            return _as_asked(asked, done) or _followed(asked, recording, trial)
    return _followed(asked, recording, trial)


def _followed(asked: Channel, recording: Recording, trial: Trial) -> list[str]:
    """What tells that the joints did not follow what was asked of them, or are told in another unit."""
    return _mended(swapped(asked, recording) or missized(asked, recording), trial)


def _as_asked(asked: Channel, done: Channel) -> list[str]:
    request, sent = side_by_side(asked, done)
    spread = np.maximum(request.std(axis=0), 1e-3 * max(ROUNDED, float(request.std())))
    off = rms(sent - request) / spread
    wrong = [k for k in range(len(off)) if off[k] > _SAME_COMMAND]
    if not wrong:
        return []
    for k in wrong:
        others = rms(sent[:, [k]] - request) / spread
        best = int(np.argmin(others))
        if best != k and others[best] < _SAME_COMMAND:
            return [
                f"the command recorded for '{asked.labels[k]}' is what was asked of '{asked.labels[best]}': the joints are "
                "in another order; give the columns their right labels in mapping.toml"
            ]
    names = ", ".join(f"'{asked.labels[k]}' ({100 * off[k]:.0f} % off)" for k in wrong[:4])
    return [
        f"the command recorded is not the one asked for: {names}; is this the log of another run, or in another unit?"
    ]


def lacks_command(trial: Trial, recordings: Sequence[Recording] = ()) -> bool:
    """Whether a trial says nothing of what its drives are told, and recordings of it do not either."""
    channels = [*trial.observed, *(name for r in recordings for name in r.channels)]
    return trial.command is None and trial.watched is None and not any(map(is_command, channels))


def fits(trial: Trial, recording: Recording) -> str:
    """What is said of a log that can be used."""
    but = "; it holds nothing that the controller commanded, without which no simulator is fitted to it: log that too"
    return f", {recording.duration:.1f} s, matches the request{but if lacks_command(trial, [recording]) else ''}"


def one_of(trials: Sequence[Trial], recording: Recording) -> list[Trial]:
    """The trials whose request a recording fits."""
    return [t for t in trials if not mismatches(t, recording)]
