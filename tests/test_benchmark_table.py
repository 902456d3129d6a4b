# SPDX-License-Identifier: Apache-2.0
"""The table of docs/benchmarks.md says what the benchmarks printed, failures too."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType

import pytest

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
RESULT = {"name": "cpu_seconds", "value": 12.345, "unit": "s", "peer": "other", "peer_value": 38.0, "ratio": 0.325}


@pytest.fixture(scope="module")
def table() -> ModuleType:
    spec = importlib.util.spec_from_file_location("benchmark_table", BENCHMARKS / "_table.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def benchmark(folder: Path, name: str, code: str) -> Path:
    path = folder / f"{name}.py"
    path.write_text(f'{code}\nif __name__ == "__main__":\n    pass\n', encoding="utf-8")
    return path


def test_only_files_that_can_be_run_are_benchmarks(table: ModuleType, tmp_path: Path) -> None:
    benchmark(tmp_path, "_table", "")
    arm = benchmark(tmp_path, "arm", "")
    (tmp_path / "shared_model.py").write_text("x = 1\n", encoding="utf-8")
    assert table.benchmarks(tmp_path) == [arm]


def test_a_result_line_becomes_a_row(table: ModuleType, tmp_path: Path) -> None:
    line = json.dumps({**RESULT, "goal": "<= 0.4", "met": True})
    outcome = table.run(benchmark(tmp_path, "arm", f"print('some table')\nprint('RESULT {line}')"), [])
    assert outcome.rows == ("| arm | cpu_seconds | 12.3 s | other | 38 s | 0.325 | <= 0.4 | yes |",)
    assert outcome.problem == ""


def test_a_figure_without_peer_or_goal_is_still_a_row(table: ModuleType) -> None:
    row = table.row("arm", {"name": "coverage", "value": 0.95, "unit": "", "peer": None, "met": False})
    assert row == "| arm | coverage | 0.95 |  |  |  |  | **no** |"


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("raise SystemExit(3)", "ended with code 3"),
        ("print('nothing')", "printed no RESULT line"),
        ("print('RESULT {')", "cannot be read"),
        ("""print('RESULT {"value": 1}')""", "cannot be read"),
    ],
)
def test_a_benchmark_that_fails_is_said_in_the_table(table: ModuleType, tmp_path: Path, code: str, said: str) -> None:
    outcome = table.run(benchmark(tmp_path, "arm", code), [])
    assert said in outcome.problem
    assert said in table.table([outcome])


def test_running_one_benchmark_keeps_the_rows_of_the_others(table: ModuleType) -> None:
    def outcome(name: str, value: float) -> object:
        return table.Outcome(name, (table.row(name, {**RESULT, "value": value}),), 1.0, "")

    page = table.with_table(
        f"# Title\n{table.BEGIN}\n{table.END}\nafter\n", table.table([outcome("b", 1), outcome("a", 2)])
    )
    page = table.with_table(page, table.table([outcome("b", 3)], table.kept_rows(page, ["b"])))
    rows = [line for line in page.splitlines() if "cpu_seconds" in line]
    assert [row.split(" | ")[:3] for row in rows] == [["| a", "cpu_seconds", "2 s"], ["| b", "cpu_seconds", "3 s"]]
    assert page.startswith("# Title\n")
    assert page.endswith("\nafter\n")


def test_the_page_of_the_project_has_a_place_for_the_table(table: ModuleType) -> None:
    page = table.PAGE.read_text(encoding="utf-8")
    assert "the new table" in table.with_table(page, "the new table")
