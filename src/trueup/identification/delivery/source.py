# SPDX-License-Identifier: Apache-2.0
"""A torque model as source code that needs nothing: a C header for a control loop, and one Python file."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterator
from importlib import resources
from string import Template

import numpy as np

from trueup.arrays import Array
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.torque_model import TorqueModel

_SYMBOLS = {"q": "position", "v": "speed", "a": "acceleration"}


def prefix(model: TorqueModel) -> str:
    """What all names in the header begin with: the model's name as C allows it."""
    return re.sub(r"\W|^(?=\d)", "_", model.tree.name, flags=re.ASCII) or "arm"


def c_header(model: TorqueModel) -> str:
    """The header's text (C99): torque of one instant in about a microsecond, no memory allocated, equal to the model."""
    own = prefix(model)
    call = {"sign(": f"{own}_sign(", "stop(q,": f"{own}_stop(state, {{k}}, q,"}
    lines = []
    for d, needs, expression in _drives(model, call):
        given = "".join(f"    const double {name} = {value};\n" for name, value in needs)
        lines.append(f"  {{ /* drive of {_plain(model.joints[d])} */\n{given}    own[{d}] = {expression};\n  }}")
    sums = [f"  torque[{j}] = rigid[0][{j}] + {_dot(model.drives[:, j], 'own')};" for j in range(model.tree.n)]
    parts = {"drives": "\n".join(lines), "sums": "\n".join(sums), "prefix": own}
    return _filled("torque.h.txt", model, lambda x: _braces(x, "{", "}"), " * ", **parts)


def python_file(model: TorqueModel) -> str:
    """The Python file's text: the same torque, from lists of numbers."""
    call = {"stop(q,": "stop(state, {k}, q,"}
    lines = []
    for d, needs, expression in _drives(model, call):
        given = ", ".join(name for name, _ in needs), ", ".join(value for _, value in needs)
        lines += [f"    {given[0]} = {given[1]}" if needs else "", f"    own[{d}] = {expression}"]
    sums = [f"turned[0][{j}] + {_dot(model.drives[:, j], 'own')}" for j in range(model.tree.n)]
    lines = [line.replace("rigid[1]", "turned[1]") for line in lines if line]
    return _filled(
        "torque.py.txt", model, lambda x: _braces(x, "(", ",)"), "", drives="\n".join(lines), sums=", ".join(sums)
    )


def _drives(model: TorqueModel, call: dict[str, str]) -> Iterator[tuple[int, list[tuple[str, str]], str]]:
    """For each drive its number, the names that its expression needs with their values, and the expression."""
    carried, k = np.asarray(np.linalg.inv(model.drives), dtype=np.float64), 0
    for d in range(model.tree.n):
        expression = model.expression(d)
        needs = [(x, _dot(model.drives[d], said)) for x, said in _SYMBOLS.items() if re.search(rf"\b{x}\b", expression)]
        if re.search(r"\bL\b", expression):
            needs.append(("L", _dot(carried[:, d], "rigid[1]")))
        for old, new in call.items():
            while new != old and (found := re.search(rf"(?<!\w){re.escape(old)}", expression)):
                expression = expression[: found.start()] + new.format(k=k) + expression[found.end() :]
                k += "{k}" in new
        yield d, needs, expression


def _filled(name: str, model: TorqueModel, text: Callable[[Array], str], before: str, **parts: str) -> str:
    tree, n = model.tree, model.tree.n
    still, sine, cosine = rotations(tree)
    sets = np.stack([model.links, model.load] if model.of_load else [model.links])
    memory = max(1, sum(effect.kind == "hysteresis" for _, effect, _ in model.terms))
    said = "\n".join(line for f in model.formulas() for line in textwrap.wrap(_plain(f), 118, subsequent_indent="    "))
    numbers = {
        "parent": tree.parent, "slides": tree.prismatic.astype(int), "axis": tree.axis, "offset": tree.offset, "still": still,
        "sine": sine, "cosine": cosine, "gravity": tree.gravity, "links": sets,
    }  # fmt: skip
    template = resources.files("trueup.identification.delivery").joinpath("templates", name)
    return Template(template.read_text(encoding="utf-8")).substitute(
        {key: text(np.asarray(value)) for key, value in numbers.items()},
        name=_plain(tree.name), n=str(n), sets=str(len(sets)), memory=str(memory), joints=_plain(", ".join(model.joints)),
        units=_plain(", ".join(dict.fromkeys(model.units))), formulas=textwrap.indent(said, before, lambda _: True), **parts,
    )  # fmt: skip


def rotations(tree: KinematicTree) -> tuple[Array, Array, Array]:
    """(n, 3, 3) each: rotation of a link in its parent's frame = still + sin(q) sine + cos(q) cosine (Rodrigues)."""
    x, y, z = tree.axis.T
    none = np.zeros(tree.n)
    K = np.array([[none, -z, y], [z, none, -x], [-y, x, none]]).transpose(2, 0, 1)
    along = tree.axis[:, :, None] * tree.axis[:, None, :]
    fixed = tree.prismatic[:, None, None]
    still = np.where(fixed, tree.rotation, tree.rotation @ along)
    sine = np.where(fixed, 0.0, tree.rotation @ K)
    return still, sine, np.where(fixed, 0.0, tree.rotation @ (np.eye(3) - along))


def _braces(values: Array, left: str, right: str) -> str:
    if values.ndim == 0:
        return repr(values.item())
    return left + ", ".join(_braces(v, left, right) for v in values) + right


def _dot(weights: Array, name: str) -> str:
    """'own[4] + 0.5*own[5]'."""
    parts = [f"{name}[{k}]" if w == 1.0 else f"{float(w)!r}*{name}[{k}]" for k, w in enumerate(weights) if w != 0.0]
    return " + ".join(parts) or "0.0"


def _plain(text: str) -> str:
    """Text that ends no comment and no string, and says nothing in a template."""
    return re.sub(r"[^\w .,:;()\[\]{}<>=+\-*/^|]", "_", text).replace("*/", "* /").replace("/*", "/ *")
