# SPDX-License-Identifier: Apache-2.0
"""Every rule's own examples are read as it says, and so are they among the columns of the other rules of its dialect."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from trueup import formats
from trueup.formats.rules import autopilots, bases, coherence, families, joints, lists, vehicles, wheels
from trueup.formats.rules.rule import Example, Rule

RULES = {"joints": joints.RULES, "vehicles": vehicles.RULES, "bases": bases.RULES}
CASES = [
    pytest.param(rule, example, id=f"{dialect}-{rule.kind}-{k}")
    for dialect, rules in RULES.items()
    for rule in rules
    for k, example in enumerate(rule.examples)
] + [
    pytest.param(None, example, id=f"{dialect}-{k}")
    for dialect, examples in {
        "families": families.EXAMPLES,
        "wheels": wheels.EXAMPLES,
        "sensors": coherence.EXAMPLES,
        "lists": lists.EXAMPLES,
        "autopilots": autopilots.EXAMPLES,
    }.items()
    for k, example in enumerate(examples)
]


def expected(text: str) -> dict[str, tuple[str, tuple[str, ...]]]:
    """Channel to unit (or units, with commas) and labels, of "command[rad] hip knee; current[] hip"."""
    parts = [re.fullmatch(r"(\w+)\[(.*)\] (.+)", part.strip()) for part in text.split(";")]
    assert all(parts), text
    return {p[1]: (p[2], tuple(p[3].split())) for p in parts if p is not None}


@pytest.mark.parametrize(("rule", "example"), CASES)
def test_an_example_is_read_as_its_rule_says(rule: Rule | None, example: Example, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(
        example.header + "\n" + example.rows.replace("|", "\n").replace(" ", ",").replace(";", " ") + "\n"
    )
    channels = formats.guess_mapping(tmp_path / "log.csv").channels
    wanted = expected(example.expected)
    there = {name: (channels[name], unit) for name, (unit, _) in wanted.items() if name in channels}
    units = {name: ",".join(channel.units) if "," in unit else channel.unit for name, (channel, unit) in there.items()}
    assert {name: (units[name], channel.labels) for name, (channel, _) in there.items()} == wanted
    # What an example of a base does not name is no base.
    assert {n for n in channels if n.startswith("base_")} <= {*wanted, "base_quat", "base_pos"}


@pytest.mark.parametrize("dialect", RULES)
def test_every_rule_has_an_example_and_no_two_kinds_share_a_name(dialect: str) -> None:
    names: dict[frozenset[str], str] = {}
    for rule in RULES[dialect]:
        assert rule.examples, rule.kind
        for name in rule.names.split(", "):
            assert names.setdefault(frozenset(name.split()), rule.kind) == rule.kind, name
