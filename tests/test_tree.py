# SPDX-License-Identifier: Apache-2.0
"""What no file of the project may hold: the address of a package index, or a path that exists on one machine only."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

# Bracketed letters keep the patterns from finding themselves.
FORBIDDEN = {
    "the address of a package index": re.compile(
        r"https?://[\w.-]*(p[y]pi|p[y]thonhosted|n[p]mjs|c[r]ates|g[o]lang|d[e]bian|m[a]ven|a[n]aconda)", re.IGNORECASE
    ),
    "an option that names a package index": re.compile(r"^\s*--(extra-)?(index-u[r]l|find-l[i]nks|trusted-h[o]st)[ =]"),
    "a path of one machine": re.compile(
        r"(?:(?<![\w.~})/])|(?<=file://))/(w[o]rk|t[m]p|r[o]ot|h[o]me|f[a]rm|U[s]ers)/"
    ),
}


def found_in(text: str) -> list[str]:
    """'line: what: the text' for each forbidden thing in a text."""
    return [
        f"{number}: {what}: {match.group().strip()}"
        for number, line in enumerate(text.splitlines(), 1)
        for what, pattern in FORBIDDEN.items()
        if (match := pattern.search(line))
    ]


def files_of_the_project() -> list[Path]:
    """What git tracks, or would track; skips where the project is not a git checkout."""
    git = ["git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    try:
        listed = subprocess.run(git, capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("not a git checkout: nothing says which files belong to the project")
    return [path for name in listed.split("\0") if name and (path := ROOT / name).is_file()]


def test_no_file_names_a_package_index_or_a_path_of_one_machine() -> None:
    problems = []
    for path in files_of_the_project():
        content = path.read_bytes()
        if b"\0" not in content[:4096]:
            found = found_in(content.decode("utf-8", errors="replace"))
            problems += [f"{path.relative_to(ROOT)}:{problem}" for problem in found]
    assert not problems, "\n".join(problems)


@pytest.mark.parametrize(
    "line",
    [
        "see https://p{}ypi.org/simple",
        "https://files.p{}ythonhosted.org/packages/x.whl",
        "--index-u{}rl=https://example.org",
        "--find-l{}inks wheels",
        "path = '/w{}ork/main'",
        "open('/t{}mp/x')",
        "file:///r{}oot/x",
    ],
)
def test_a_planted_address_or_path_is_caught(line: str) -> None:
    assert len(found_in(line.format(""))) == 1


@pytest.mark.parametrize(
    "line", ["https://example.org/home/x", "./tmp/x", "package://w{}ork/x.stl", ".venv/bin/python"]
)
def test_an_ordinary_address_or_relative_path_is_left_alone(line: str) -> None:
    assert found_in(line.format("")) == []


def test_locks_pin_every_package_with_a_hash() -> None:
    for name in ("run.txt", "dev.txt"):
        text = (ROOT / "requirements" / name).read_text("utf-8").replace("\\\n", " ")
        lines = [line for line in text.splitlines() if line.strip() and not line.strip().startswith("#")]
        assert lines
        assert [line for line in lines if not re.match(r"[\w.-]+==\S+.* --hash=sha256:[0-9a-f]{64}", line)] == []


def test_the_two_locks_agree() -> None:
    pins = {}
    for name in ("run", "dev"):
        text = (ROOT / "requirements" / f"{name}.txt").read_text("utf-8")
        pins[name] = set(re.findall(r"^([\w.-]+==[^\s;]+)", text, re.MULTILINE))
    assert pins["run"] <= pins["dev"]
