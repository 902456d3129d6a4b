# SPDX-License-Identifier: Apache-2.0
"""What a command says: text from files is shown, never obeyed by the terminal."""

from __future__ import annotations

import re
from collections.abc import Container, Iterable
from json import dumps, loads
from typing import Any

from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

# C0 but tab and newline, DEL and C1, and what turns the direction of writing.
_UNSAFE = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")


def shown(text: str) -> str:
    r"""A text with its control characters written out, such as '\x1b': a name in a file cannot move the cursor."""
    return _UNSAFE.sub(lambda c: f"\\x{ord(c[0]):02x}" if ord(c[0]) < 256 else f"\\u{ord(c[0]):04x}", text)


def tell(console: Console, line: str) -> None:
    """A line of rich's markup, in which texts from files must be escaped; the terminal wraps it, nothing is highlighted."""
    console.print(line, soft_wrap=True, highlight=False)


def table_of(*titles: str, words: Container[str] = ("",), title: str = "", caption: str = "") -> Table:
    """A table without rows: columns of `words` to the left, of numbers to the right, with its title above."""
    made = Table(box=SIMPLE, title=title, title_justify="left", caption=caption, caption_justify="left")
    for each in titles:
        made.add_column(each, justify="left" if each in words else "right")
    return made


def notes(console: Console, sentences: Iterable[object], *, quiet: bool = False) -> None:
    """What was noticed, a sentence a line; nothing with `quiet`."""
    for sentence in () if quiet else sentences:
        tell(console, f"[yellow]note[/] {escape(str(sentence))}")


class PlainConsole(Console):
    """A console that writes control characters in texts out."""

    def render_str(self, text: str, **how: Any) -> Text:
        """See Console."""
        return super().render_str(shown(text), **how)

    def print_json(self, json: str | None = None, *, data: Any = None, **_: Any) -> None:
        """JSON, of a text or of plain data, with control characters as JSON escapes them."""
        plain = dumps(data if json is None else loads(json), indent=2, ensure_ascii=False)
        self.out(_UNSAFE.sub(lambda c: f"\\u{ord(c[0]):04x}", plain), highlight=False)
