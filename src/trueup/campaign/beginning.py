# SPDX-License-Identifier: Apache-2.0
"""The first event of a campaign, and whether model and task still are those that it began with."""

from __future__ import annotations

import dataclasses
import os
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from trueup.campaign.doses import Doses
from trueup.campaign.events import Begun, Event, Row
from trueup.campaign.journal import read_times
from trueup.campaign.parts import Parts
from trueup.campaign.rehearsal import blamed
from trueup.errors import JournalError, PlanError, TrueupError
from trueup.recording import Recording
from trueup.rounding import PRINTED
from trueup.tasks.task import counted_by, unit_of

_ROWS = 4
"""Simulated: today's settings in the simulator as it came, and others from the ranges of both, so that these count too."""


def begun(checksum: str, seed: int, version: str, parts: Parts, doses: Doses | None) -> Begun:
    """What a campaign begins with, but for its samples (see `sampled`)."""
    task = parts.task
    units = {p.name: "" if p.unit == "1" else p.unit for p in task.parameters.parameters}
    graded = (doses.names, doses.first, doses.ways) if doses else ((), (), ())
    before = {r.name: _sums(r) for r in (*parts.recordings, *parts.held_out)}
    return Begun(checksum, seed, version, unit_of(task), units, *graded, counted_by(task), recordings=before)


def sampled(first: Begun, parts: Parts) -> Begun:
    """The event with what the task scores in a few simulations: all that is decided later follows from such scores."""
    return dataclasses.replace(first, samples=_samples(parts))


def begun_with(recordings: Sequence[Recording], past: Sequence[Event], say: Callable[[str], None]) -> list[Recording]:
    """Those of the plan's recordings that the campaign began with, by check sums in its first event (`past`: its journal).

    What a pattern finds by now beside these is said, and left aside: calibrations that the journal holds did not see it.
    Raises JournalError where one is gone or was edited. All of them where nothing is known.
    """
    known = past[0].recordings if past and isinstance(past[0], Begun) else {}
    if not known:
        return list(recordings)
    same = {r.name for r in recordings if known.get(r.name) == _sums(r)}
    # Names of one file change with its neighbours'.
    moved = Counter(sums for name, sums in known.items() if name not in same)
    kept, others = list[Recording](), list[str]()
    for recording in recordings:
        here = recording.name in same
        if here or moved[_sums(recording)] > 0:
            kept.append(recording)
            moved[_sums(recording)] -= not here
        else:
            others.append(recording.name)
    if lost := [name for name, sums in known.items() if name not in same and moved[sums] > 0]:
        edited = [f"{name} ({'edited' if name in others else 'gone'})" for name in lost]
        raise JournalError(
            f"recordings of the plan are no longer what the campaign began with: {', '.join(edited)}; what is in the journal "
            "would be mixed with what comes of others. Put them back, and `trueup resume` goes on; or begin anew with "
            "`trueup run --out DIR`"
        )
    if others:
        say(
            f"note: recordings that came since the campaign began are not used in it: {', '.join(others)}; a campaign that "
            "is begun anew (`trueup run --out DIR`) uses them"
        )
    return kept


def _sums(recording: Recording) -> str:
    """Check sums of the files that a recording was read from."""
    return " ".join(digest for key, digest in recording.provenance.items() if key.startswith("sha256 of "))


def require_unedited(first: Begun, now: Begun, parts: Parts, folder: Path) -> str:
    """Raises JournalError where simulator and task score otherwise than when the campaign began, and files beside its plan
    were edited: what its journal holds would be mixed with what comes of others. Where another version of trueup wrote it,
    or no such file was edited (walks are chaotic, and another machine rounds otherwise), that is a doubt, which is returned.

    '' elsewhere, for journals of earlier versions too: they have no samples.
    """
    if not first.samples or _same(first.samples, again := _samples(parts)):
        return ""
    if not _same(again, _samples(parts)):  # the task draws lots of its own: nothing can be told
        return ""
    if _same(first.samples[:1], again[:1]):
        words = f"some settings score otherwise in the simulator than when the campaign in {folder} began"
    else:
        was = (
            f"{first.samples[0]:.4g} when the campaign in {folder} began, {again[0]:.4g} now" if again else "otherwise"
        )
        words = f"simulated with the settings of today the task scored {was}"
    if first.version != now.version:
        return f"{words}: trueup {first.version} began it, this is {now.version}"
    plan = parts.beside
    files = _edited_since(plan, folder) if plan is not None else ""
    if not files:
        return (
            f"{words}, and no file beside the plan was changed since then: another machine, or another version of an engine, "
            "may simulate otherwise. If a model or a task elsewhere was edited, begin anew with `trueup run --out DIR`"
        )
    recordings = os.path.relpath(folder / "recordings", plan) if plan is not None else folder / "recordings"
    raise JournalError(
        f"{words}: the model, the task, or a file that they read was edited{files}, and what is in the journal would be "
        "mixed with what comes of them now. Put them back as they were, and `trueup resume` goes on; or begin anew with "
        f'`trueup run --out DIR`. Runs made so far may be used there: [calibrate] recordings = ["{recordings}/*.parquet"]'
    )


def _samples(parts: Parts) -> Row:
    """Scores of a few settings in a few simulators; () where not all of them can be simulated."""
    task, simulator = parts.task, parts.simulator
    rng = np.random.default_rng(0)
    spaces = (simulator.parameters, task.parameters)
    drawn = [s.from_unit(rng.random((_ROWS, int(s.free.sum())))) for s in spaces]
    for space, rows in zip(spaces, drawn, strict=True):
        rows[0] = space.nominal
    try:
        with blamed(f"task '{task.name}', before anything moved", PlanError):
            rollouts = simulator.rollout(task.trials, np.concatenate(drawn, axis=1), task.controllers)
            return tuple(float(x) for x in np.asarray(task.score(rollouts), dtype=np.float64).ravel())
    except TrueupError:  # somewhere in the ranges: a search passes such settings over
        return ()


def _same(a: Row, b: Row) -> bool:
    return len(a) == len(b) and bool(np.allclose(a, b, rtol=PRINTED, atol=0.0, equal_nan=True))


def _edited_since(plan: Path, folder: Path) -> str:
    """Names of the files beside the plan, but for the campaign's own, that were changed after the campaign had begun."""
    began = read_times(folder).get(0)
    own = {f.name for f in folder.iterdir() if f.suffix in (".jsonl", ".json", ".html") or f.name == "lock"}
    files = [f for f in plan.iterdir() if f.is_file() and f.name not in own]
    late = sorted(f.name for f in files if began is not None and f.stat().st_mtime > began)
    return f" (changed since then: {', '.join(late)})" if late else ""
