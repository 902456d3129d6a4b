# SPDX-License-Identifier: Apache-2.0
"""Who may import whom, how long files and functions may be, how a file opens: read from the source, not from memory.

Longer than 300 lines because the rules, the checker and the proof that it checks belong together.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "trueup"

# ---- the rules; names are modules or folders below trueup/, a folder stands for all in it, "" for everything ----

NOUNS = (
    "arrays",
    "cores",
    "compiled",
    "evidence",
    "files",
    "extensions",
    "parameters",
    "recording",
    "units",
    "noise",
    "rounding",
    "samples",
    "instant",
    "trial",
    "watched_run",
    "reckoned",
    "ends",
    "typed_toml",
    "chance",
    "paths",
    "calibration",
    "verdicts",
    "proportion",
    "inspection",
    "formats",
    "film",
    "model_files",
    "tracking",
    "articulated.pose",  # how recordings tell that of a free base
)
FAMILIES = {  # folder -> its base, the protocol that the others may know
    "robots": "robots.robot",
    "engines": "engines.simulator",
    "controllers": "controllers.controller",
    "tasks": "tasks.task",
    "discrepancies": "discrepancies.discrepancy",
    "search": "search.search",
    "evaluation": "evaluation.evaluator",
}
BASES = (*FAMILIES.values(), "engines.floating", "engines.family")
ANYTHING = ("",)


@dataclass(frozen=True)
class Rule:
    """`who` may import itself, `errors` and `may`; inside functions (or for types only) also `lazily`."""

    who: str
    may: tuple[str, ...]
    lazily: tuple[str, ...] = ()


RULES = (
    Rule("errors", ()),
    *(Rule(noun, NOUNS) for noun in NOUNS),
    *(Rule(base, (*NOUNS, *BASES)) for base in BASES),
    # siblings of a family know its base and the nouns; another family or sibling only where it is the point:
    *(Rule(family, (base, *NOUNS)) for family, base in FAMILIES.items()),
    Rule("robots", ("robots.robot", "controllers.controller", "engines.simulator", *NOUNS)),  # stand-ins simulate
    Rule("search.least_squares", ("search.search", "search.bounded_step", "search.robust", *NOUNS)),  # its arithmetic
    Rule("search.filtering", ("search.search", "search.bounded_step", "search.robust", *NOUNS)),
    Rule("evaluation.worker", ("evaluation.evaluator", *NOUNS)),
    *(Rule(f"evaluation.{name}", ("evaluation", *NOUNS)) for name in ("roster", "cluster")),  # they use all the rest
    Rule("search.optuna", ("search.search", "search.study_file", *NOUNS)),  # the study for the dashboard
    Rule(
        "robots.stand_in_vehicle", ("robots.robot", "controllers.stanley", *NOUNS)
    ),  # its own controller is a Stanley too
    # an agent in a running game: controllers that a task brings along
    Rule(
        "robots.rcss",
        ("robots.robot", "controllers.controller", "engines.simulator", "tasks.task", *NOUNS),
    ),
    Rule("tasks", ("tasks.task", "controllers", "engines.simulator", *NOUNS)),
    # how a walk is graded, and how it sways
    Rule("tasks.follow_path", ("tasks.task", "tasks.steered", "controllers", "engines.simulator", *NOUNS)),
    Rule("tasks.walking", ("tasks.task", "tasks.paces", "tasks.sway", "controllers", "engines.simulator", *NOUNS)),
    Rule("tasks.omni_walk", ("tasks.walking", "engines.simulator", *NOUNS)),
    # what bodies, joints and drives have in common whatever simulates them
    Rule("articulated", ("engines.simulator", "controllers.controller", *NOUNS)),
    Rule("engines", ("engines.simulator", "engines.family", "articulated", "controllers.controller", *NOUNS)),
    # one servo by itself: gains that recordings name and compiled loops are those of articulated; it is fitted by arithmetic
    Rule("actuators", ("articulated", "search", *NOUNS)),
    # MJCF and URDF are read by MuJoCo's reader, whatever simulates them
    Rule("engines.dart", ("engines.mujoco", "engines.family", "articulated", *NOUNS)),
    # an arm as its dynamics are fitted is read off a model,
    Rule("engines.mujoco.setup.torques_given", ("engines.mujoco", "articulated", "identification", *NOUNS)),
    # and so is what a walk must know of a biped
    Rule("engines.mujoco.biped", ("engines.mujoco", "controllers.walk_engine", *NOUNS)),
    # the vehicle runs the compiled Stanley law inside its own loop, and says what counts as an error of a prediction
    Rule(
        "engines.vehicle",
        (
            "engines.simulator",
            "engines.family",
            "controllers.controller",
            "controllers.stanley",
            "discrepancies.discrepancy",
            "discrepancies.rigid",
            *NOUNS,
        ),
    ),
    Rule("discrepancies", ("discrepancies.discrepancy", "engines.simulator", *NOUNS)),  # they compare with a rollout
    # an MJCF is read as MuJoCo compiles it
    Rule(
        "discrepancies.path_shape",
        ("discrepancies.discrepancy", "discrepancies.dtw", "discrepancies.weighted", "engines.simulator", *NOUNS),
    ),
    # it reads the measured samples off as the weighted one does
    Rule("discrepancies.rigid", ("discrepancies.discrepancy", "discrepancies.weighted", "engines.simulator", *NOUNS)),
    # the orientation of a free base
    Rule("discrepancies.whole_body", ("discrepancies.discrepancy", "engines.simulator", "articulated.pose", *NOUNS)),
    # excitation is designed with the searches, which are arithmetic; MJCF is read and written as MuJoCo has it
    Rule("identification", ("engines.simulator", "controllers.playback", "search", *NOUNS), ("engines.mujoco",)),
    Rule("excitation", ("identification", "search", *NOUNS), ("engines.mujoco",)),
    Rule("grounding", ("engines.simulator", "controllers.controller", "controllers.playback", *NOUNS)),
    # what the loop computes with when nobody gives it something else; never a concrete simulator or robot
    Rule("loop", (*BASES, "identification", "grounding", "discrepancies", "search", *NOUNS)),
    Rule("campaign", ("loop", "campaign", *BASES, *NOUNS)),
    # the names that a plan may use, and what is behind them; `engines.family` leads from model files to engines
    Rule("campaign.kinds", ("loop", *BASES, *NOUNS), lazily=ANYTHING),
    *(
        Rule(name, (*BASES, *NOUNS), lazily=ANYTHING)
        for name in ("campaign.motions", "campaign.walks", "campaign.cars")
    ),
    Rule("campaign.drives", ("engines.vehicle.localisation", "discrepancies.rigid", *BASES, *NOUNS)),
    Rule(
        "report",
        (
            "campaign.journal",
            "campaign.events",
            "campaign.edges",
            "campaign.history",
            "campaign.plan",
            "identification.estimation.result",
            *NOUNS,
        ),
    ),
    Rule("studies", ANYTHING),  # an experiment put together by hand
    Rule(
        "commands",
        ("report", "campaign", "identification.estimation.result", *NOUNS),
        lazily=(
            "loop",
            "identification",
            "excitation",
            "actuators",
            "grounding",
            "studies",
            "evaluation",
            "engines.simulator",
            "engines.family",
        ),
    ),
    Rule("cli", ("report", "campaign"), lazily=("commands", "loop", *NOUNS)),
    Rule("testing", ("articulated", *BASES, *NOUNS)),  # contract checks, for those who extend it
    Rule("__main__", ("cli",)),
    Rule("__init__", (), lazily=ANYTHING),  # public names, imported when used
)
NEVER_REACHES = {
    "loop": ("mujoco",),
    "articulated": ("mujoco",),
}  # not by way of another module either, and not inside a function
HEAVY = ("mujoco", "numba", "cma", "plotly", "pyarrow", "rosbags", "scipy", "numpy")  # never by `import trueup`
LONGEST_FILE, LONGEST_FUNCTION = 300, 40
EXCUSE = re.compile(r"\blong(er)?\b.*\bbecause\b", re.IGNORECASE | re.DOTALL)  # "Longer than 40 lines because ..."
OPENING = "# SPDX-License-Identifier: Apache-2.0"

# ---- reading the source ----


@dataclass(frozen=True)
class Import:
    """One imported module. `lazy`: inside a function; `typing_only`: under `if TYPE_CHECKING`."""

    module: str
    line: int
    lazy: bool
    typing_only: bool


def modules_of(source: Path) -> dict[str, Path]:
    """Module name below trueup -> file; a folder's `__init__.py` has the folder's name, that of trueup `__init__`."""
    names = {}
    for path in sorted(source.rglob("*.py")):
        parts = path.relative_to(source).with_suffix("").parts
        names[".".join(parts if len(parts) == 1 or parts[-1] != "__init__" else parts[:-1])] = path
    return names


def imports_of(name: str, path: Path, known: Mapping[str, Path]) -> list[Import]:
    """All imports of a file, own ones as `trueup...`, relative ones resolved."""
    package = ["trueup", *name.split(".")]
    if path.name != "__init__.py" or name == "__init__":
        package.pop()
    found: list[Import] = []

    def visit(node: ast.AST, lazy: bool, typing_only: bool) -> None:
        for module in _imported(node, package, known):
            found.append(Import(module, getattr(node, "lineno", 0), lazy, typing_only))
        lazy = lazy or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        if isinstance(node, ast.If) and _last_name(node.test) == "TYPE_CHECKING":
            for child in node.body:
                visit(child, lazy, True)
            for child in node.orelse:
                visit(child, lazy, typing_only)
            return
        for child in ast.iter_child_nodes(node):
            visit(child, lazy, typing_only)

    visit(parsed(path.read_text(encoding="utf-8")), False, False)
    return found


def _imported(node: ast.AST, package: list[str], known: Mapping[str, Path]) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        above = package[: len(package) - node.level + 1] if node.level else []
        base = ".".join([*above, *([node.module] if node.module else [])])
        for alias in node.names:  # `from trueup.loop import calibrate` imports the module trueup.loop.calibrate
            full = f"{base}.{alias.name}"
            yield full if full.removeprefix("trueup.") in known else base
    elif isinstance(node, ast.Call) and node.args and "import_module" in _last_name(node.func):
        match node.args[0]:
            case ast.Constant(value=str(module)):
                yield module


def _last_name(function: ast.expr) -> str:
    """The last part of what is called: 'import_module' of `importlib.import_module`."""
    return (
        function.attr if isinstance(function, ast.Attribute) else function.id if isinstance(function, ast.Name) else ""
    )


@cache
def parsed(text: str) -> ast.Module:
    """The syntax of a file, which several rules look at."""
    return ast.parse(text)


# ---- checking ----


def within(module: str, names: tuple[str, ...]) -> bool:
    """Is `module` one of `names`, or in one of these folders?"""
    return any(name == "" or module == name or module.startswith(f"{name}.") for name in names)


def rule_for(name: str) -> Rule | None:
    """The most specific rule that covers a module; of two for the same name the later one."""
    covering = [rule for rule in RULES if within(name, (rule.who,))]
    return max(reversed(covering), key=lambda rule: len(rule.who)) if covering else None


def itself(name: str, rule: Rule) -> str:
    """What a module may always import: its layer; in a family only what is below its own name, for the folder its base.

    So importing a base, which runs the `__init__.py` of its folder, never loads a concrete sibling.
    """
    if name in FAMILIES:
        return FAMILIES[name]
    return ".".join(name.split(".")[:2]) if rule.who in FAMILIES else rule.who


def broken_imports(source: Path) -> list[str]:
    """One sentence for each import that breaks a rule: where, what, and the rule."""
    known, problems = modules_of(source), []
    for name, path in known.items():
        rule = rule_for(name)
        if rule is None:
            problems.append(f"{path}: no rule says what 'trueup.{name}' may import; add it to RULES")
            continue
        always = ("errors", itself(name, rule), *rule.may)
        for one in imports_of(name, path, known):
            own = "" if one.module == "trueup" else one.module.removeprefix("trueup.")
            if own and own == one.module:
                continue  # another package
            allowed = (*always, *rule.lazily) if one.lazy or one.typing_only else always
            if within(own, allowed):
                continue
            may = ", ".join(always) + (f"; inside functions also {', '.join(rule.lazily)}" if rule.lazily else "")
            problems.append(f"{path}:{one.line}: {name} imports {one.module}, but {rule.who} may only import {may}")
    return problems


def chains_to(source: Path, layer: str, package: str) -> list[str]:
    """The ways by which importing a module of `layer` ends in a foreign `package`, each as `a -> b -> package`."""
    known = modules_of(source)
    found: list[str] = []
    imports = cache(lambda name: imports_of(name, known[name], known))

    def walk(name: str, chain: tuple[str, ...], seen: set[str]) -> None:
        seen.add(name)
        for one in imports(name):
            if one.typing_only:
                continue
            if within(one.module, (package,)):
                found.append(f"{known[chain[0]]}: " + " -> ".join([*chain, one.module]))
            parts = one.module.removeprefix("trueup.").split(".") if one.module.startswith("trueup.") else []
            for depth in range(1, len(parts) + 1):  # importing a.b.c runs a and a.b first
                below = ".".join(parts[:depth])
                if below in known and below not in seen:
                    walk(below, (*chain, below), seen)

    for name in known:
        if within(name, (layer,)):
            walk(name, (name,), set())
    return found


def broken_shapes(source: Path) -> list[str]:
    """One sentence for each file that opens wrongly or is too long, and each function that is too long."""
    problems = []
    for path in modules_of(source).values():
        text = path.read_text(encoding="utf-8")
        problems += wrong_opening(path, text)
        tree, lines = parsed(text), text.count("\n")
        if lines > LONGEST_FILE and not EXCUSE.search(ast.get_docstring(tree) or ""):
            problems.append(
                f"{path}: {lines} lines; at most {LONGEST_FILE}, or its docstring says 'longer ... because'"
            )
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                lines, why = _lines(node), ast.get_docstring(node) or ""
                if lines > LONGEST_FUNCTION and not EXCUSE.search(why):
                    problems.append(
                        f"{path}:{node.lineno}: {node.name}() has {lines} lines without its docstring; "
                        f"at most {LONGEST_FUNCTION}, or the docstring says 'longer ... because'"
                    )
    return problems


def _lines(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    first = node.body[0]
    docstring = ast.get_docstring(node) is not None and (first.end_lineno or 0) - first.lineno + 1
    return (node.end_lineno or node.lineno) - node.lineno + 1 - int(docstring)


def wrong_opening(path: Path, text: str) -> list[str]:
    """A file opens with the licence line, then a docstring whose first line says what the file is for."""
    licence, docstring = [*text.split("\n", 2), "", ""][:2]
    if licence != OPENING:
        return [f"{path}:1: the first line must be '{OPENING}'"]
    if not re.match(r'r?"""\S.*[.:!?]("""|\s*$)', docstring):
        return [f"{path}:2: the second line must be a docstring: one sentence that says what the file is for"]
    return []


# ---- the project keeps the rules ----


def test_every_import_keeps_to_the_layers() -> None:
    assert "errors" in modules_of(SOURCE), "the checker does not see the source"
    assert not (problems := broken_imports(SOURCE)), "\n".join(problems)


@pytest.mark.parametrize(("layer", "package"), [(a, b) for a, names in NEVER_REACHES.items() for b in names])
def test_a_layer_never_reaches_what_it_must_not_know(layer: str, package: str) -> None:
    assert not (chains := chains_to(SOURCE, layer, package)), "\n".join(chains)


def test_files_open_alike_and_stay_short() -> None:
    assert not (problems := broken_shapes(SOURCE)), "\n".join(problems)


def test_tests_benchmarks_and_examples_open_like_the_source() -> None:
    files = [path for folder in ("tests", "benchmarks", "examples") for path in sorted((ROOT / folder).rglob("*.py"))]
    assert not (problems := [p for path in files for p in wrong_opening(path, path.read_text("utf-8"))]), problems


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = f"import sys, trueup; print(*(name for name in {HEAVY} if name in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == []


def test_a_calibration_begins_without_what_few_need() -> None:
    begins = "trueup.loop.calibrate, trueup.engines.mujoco.rollout, trueup.formats, trueup.report"
    # pycma brings all of matplotlib where that is installed: half a second.
    code = f"import sys, {begins}; print(*(n for n in ('cma', 'matplotlib', 'scipy.signal', 'pandas') if n in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not done.stdout.strip()


@pytest.mark.parametrize("layer", NEVER_REACHES)
def test_importing_what_knows_no_engine_loads_no_mujoco(layer: str) -> None:
    names = [f"trueup.{name}" for name in modules_of(SOURCE) if within(name, (layer,))]
    code = f"import importlib, sys; [importlib.import_module(n) for n in {names}]; print('mujoco' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "False"), done.stderr


# ---- and the checker would notice ----

PLANTED = [  # file, what it holds, what must be said
    ("recording.py", "from trueup.loop import calibrate", "recording imports trueup.loop.calibrate, but"),
    ("recording.py", "from .loop.calibrate import fit", "recording imports trueup.loop.calibrate, but"),
    ("recording.py", "import importlib\nimportlib.import_module('trueup.loop')", "recording imports trueup.loop, but"),
    ("recording.py", "from trueup import Recording", "recording imports trueup, but"),
    ("controllers/stanley.py", "from trueup.controllers.playback import P", "but controllers may only import errors,"),
    ("controllers/__init__.py", "from .playback import Playback", "controllers imports trueup.controllers.playback"),
    ("loop/calibrate.py", "def f():\n    from trueup.engines.mujoco.model import M", "loop may only import"),
    ("report/report.py", "from trueup.campaign import kinds", "report may only import"),
    ("campaign/kinds.py", "from trueup.engines.mujoco import model", "inside functions also"),
    ("cli.py", "def f():\n    from trueup.engines.mujoco import model", "cli may only import"),
    ("shortcuts.py", "", "no rule says what 'trueup.shortcuts' may import"),
]


@pytest.fixture
def planted(tmp_path: Path) -> Path:
    """A small package that keeps all the rules."""
    files = ("__init__", "errors", "recording", "cli", "loop/__init__", "loop/calibrate", "controllers/playback")
    for name in (*files, "engines/mujoco/__init__", "engines/mujoco/model", "campaign/kinds"):
        _plant(tmp_path / f"{name}.py", "from trueup.errors import E" if name != "errors" else "")
    _plant(tmp_path / "__init__.py", "def f():\n    from trueup.recording import R")
    _plant(tmp_path / "campaign/kinds.py", "def f():\n    from trueup.engines.mujoco import model")
    assert broken_imports(tmp_path) == broken_shapes(tmp_path) == []
    return tmp_path


def _plant(path: Path, code: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f'{OPENING}\n"""What it is for."""\n\n{code}\n', encoding="utf-8")


@pytest.mark.parametrize(("file", "code", "said"), PLANTED)
def test_a_planted_import_is_caught(planted: Path, file: str, code: str, said: str) -> None:
    _plant(planted / file, code)
    (problem,) = broken_imports(planted)
    assert said in problem
    assert str(planted / file) in problem


def test_a_way_round_to_mujoco_is_caught(planted: Path) -> None:
    _plant(planted / "recording.py", "from trueup.engines.mujoco.model import M")
    _plant(planted / "engines/mujoco/__init__.py", "import mujoco.batch")
    _plant(planted / "loop/calibrate.py", "def f():\n    from trueup import recording")
    (chain,) = chains_to(planted, "loop", "mujoco")
    assert chain.endswith("loop.calibrate -> recording -> engines.mujoco -> mujoco.batch")


def test_a_file_or_function_that_is_too_long_is_caught_unless_it_says_why(planted: Path) -> None:
    body = "\n".join(["    pass"] * 41)
    _plant(planted / "cli.py", f"def f():\n{body}")
    assert ["f() has 42 lines" in problem for problem in broken_shapes(planted)] == [True]
    _plant(planted / "cli.py", f'def f():\n    """Do.\n\n    Longer, because it is a table.\n    """\n{body}')
    assert broken_shapes(planted) == []
    _plant(planted / "cli.py", "\n" * 300)
    assert ["at most 300" in problem for problem in broken_shapes(planted)] == [True]


@pytest.mark.parametrize("text", ['"""Do."""\n', f"{OPENING}\nimport os\n", f'{OPENING}\n"""\nLate.\n"""\n', ""])
def test_a_file_that_opens_otherwise_is_caught(text: str) -> None:
    assert len(wrong_opening(Path("x.py"), text)) == 1
