# SPDX-License-Identifier: Apache-2.0
"""The first page that a newcomer sees: one sentence, one picture, one table in plain words, and what to do next."""

from __future__ import annotations

from pathlib import Path

from trueup.formats.aside import write_aside
from trueup.report.markup import Markup, join, tag
from trueup.report.parts import Section, caption, cells, head, key, page, row, table
from trueup.report.plots import AFTER, BEFORE
from trueup.studies.stanley import chasi
from trueup.studies.stanley.figures import deviation
from trueup.studies.stanley.study import Study
from trueup.studies.stanley.table import improvement

_STYLE = """
p.verdict { font-size: 21px; line-height: 1.4; margin: 4px 0 14px; }
section pre { background: var(--wash); padding: 12px 16px; overflow-x: auto; font-size: 13.5px; margin: 6px 0 16px; }
figure svg { width: 100%; height: auto; }
"""
_NEXT = (
    ("A robot that follows a path: its gains, in rounds of a few drives. trueup hands out what to drive and takes the logs.",
     "trueup new my-robot --from stanley\ncd my-robot          # campaign.toml says what to edit\ntrueup run"),
    ("An arm, hand or legged robot: first look at the logs, then make its model (MJCF or URDF) replay them.",
     "trueup inspect logs/*.csv --model robot.xml\n"
     "trueup calibrate robot.xml logs/*.csv --hold-out NAME_OF_ONE_LOG --out fit"),
    ("An arm that is to be told its torques: a motion that shows them, then a dynamic model from its logs.",
     "trueup excite arm.urdf --out motion\ntrueup identify arm.urdf logs/*.csv --hold-out 30% --out model"),
    ("Nothing at hand yet? The same with a simulated arm.", "trueup demo --robot arm"),
)  # fmt: skip


def write_demo_report(study: Study, path: Path) -> Path:
    """Writes the page and returns where. Raises OutputError; an older one is untouched then."""
    parts = (
        Section("better", "Better?", "Does the robot drive better?", _how_it_went(study)),
        Section("next", "Your robot", "And now with your own robot", _next()),
    )
    subtitle = ["a simulated robot whose truth its simulator does not know", f"{study.seconds:.0f} s"]
    write_aside(page("campaign.html", "A robot learns to keep to its path", subtitle, parts, style=_STYLE), path)
    return path


def _how_it_went(study: Study) -> Markup:
    initial, once, rounds = study.errors
    drives = len(study.rounds.trials)
    simulated = sum(r.tried for r in study.rounds.rounds)
    sentence = (
        f"The robot drove {_mm(initial)} beside its path; now it drives {_mm(rounds)} beside it, after {drives} drives of "
        f"{chasi.DURATION:.0f} s and {simulated} tries in a simulator that was made to agree with it."
    )
    before, after = study.driven
    runs = [("before", before, BEFORE), ("after", after, AFTER)]
    drawn = join(key(("before", "as it came"), ("after", "tuned in rounds")), deviation(study.paper.desired, runs))
    rows = [
        row("as it came", cells(_mm(initial), "", "1")),
        row("tuned once, in the simulator that its first drive made", cells(_mm(once), _less(initial, once), "2")),
        row(
            "tuned in rounds: try, learn, simulate, try again", cells(_mm(rounds), _less(initial, rounds), str(drives))
        ),
    ]
    titles = head("The robot", "Beside its path", "Less by", "Drives", numbers=(1, 2, 3))
    said = "Beside its path: the root mean square distance of the steered axle, as it truly is."
    return join(tag("p", sentence, class_="verdict"), tag("figure", drawn), table(titles, rows), caption(said))


def _next() -> Markup:
    steps = [join(tag("p", words), tag("pre", commands)) for words, commands in _NEXT]
    more = tag("p", "Every command explains itself with --help. What stands behind this page, with the published method "
               "panel by panel and what goes beyond it: ", tag("a", "the study", href="study.html"), ".")  # fmt: skip
    return join([*steps, more])


def _mm(error: float) -> str:
    return f"{1e3 * error:.0f} mm"


def _less(before: float, after: float) -> str:
    return f"{improvement(before, after):.0f} %"
