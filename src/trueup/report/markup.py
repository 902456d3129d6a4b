# SPDX-License-Identifier: Apache-2.0
"""HTML and SVG elements from Python, escaped by construction: only `Markup` is let through as it is."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable

_CONTROL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff]")
"""Characters that no HTML or XML file may hold: control characters and lone surrogates."""
_EMPTY = frozenset({"circle", "input", "line", "path", "rect"})
_JOINT = re.compile(r"(?<=[._/-])(?=\w)")


class Markup(str):
    """Text that is markup already; everything else is escaped when it becomes a child or an attribute."""

    __slots__ = ()


Child = str | Iterable[str] | None
"""What an element may hold: text, markup, several of them, or nothing."""


def tag(name: str, *children: Child, **attributes: str | float | bool | None) -> Markup:
    """The element `name` around `children`.

    Attributes: a trailing underscore is dropped (`class_`), inner ones become hyphens (`data_sort`); True
    writes the name alone, None and False leave it out.
    """
    written = "".join(_attribute(key, value) for key, value in attributes.items())
    if name in _EMPTY:
        return Markup(f"<{name}{written}/>")
    return Markup(f"<{name}{written}>{join(*children)}</{name}>")


def join(*children: Child) -> Markup:
    """The children one after the other, plain text escaped."""
    return Markup("".join(_child(child) for child in children))


def escape(text: str) -> Markup:
    """`text` as it may stand in an element or a quoted attribute."""
    return Markup(html.escape(_CONTROL.sub("\ufffd", text), quote=True))


def breakable(name: str) -> Markup:
    """A long technical name that may be broken after its dots, hyphens and underscores."""
    return Markup("<wbr>".join(escape(part) for part in _JOINT.split(name)))


def _child(child: Child) -> str:
    if child is None:
        return ""
    if isinstance(child, Markup):
        return child
    if isinstance(child, str):
        return escape(child)
    return "".join(_child(part) for part in child)


def _attribute(key: str, value: str | float | bool | None) -> str:
    if value is None or value is False:
        return ""
    name = key.rstrip("_").replace("_", "-")
    if value is True:
        return f" {name}"
    return f' {name}="{escape(value if isinstance(value, str) else format(value, ".6g"))}"'
