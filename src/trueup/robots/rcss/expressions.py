# SPDX-License-Identifier: Apache-2.0
"""S-expressions as RoboCup servers send them: `(HJ (n laj3)(ax -1.02))`, read without recursion."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import TypeAlias

from trueup.errors import TrialError

Expression: TypeAlias = "str | list[Expression]"

_TOKEN = re.compile(r"[()]|[^\s()]+")


def parse(message: bytes) -> list[Expression]:
    """The expressions of a message, atoms as text. Raises TrialError that shows where a message is malformed."""
    deepest = 16  # Levels of brackets; the protocol's own messages have five
    text = message.decode("utf-8", errors="replace")
    top: list[Expression] = []
    inside = [top]
    for token in _TOKEN.finditer(text):
        word = token.group()
        if word == "(":
            if len(inside) > deepest:
                raise _malformed(text, token.start(), f"brackets are nested more than {deepest} deep")
            inside.append([])
            inside[-2].append(inside[-1])
        elif word == ")":
            if len(inside) == 1:
                raise _malformed(text, token.start(), "a bracket closes that was not opened")
            inside.pop()
        else:
            inside[-1].append(word)
    if len(inside) > 1:
        raise _malformed(text, len(text), f"{len(inside) - 1} brackets are left open")
    return top


def named(expressions: Sequence[Expression]) -> Iterator[tuple[str, list[Expression]]]:
    """Those that are lists which begin with a word: the word, and what follows it."""
    for each in expressions:
        if isinstance(each, list) and each and isinstance(each[0], str):
            yield each[0], each[1:]


def _malformed(text: str, at: int, why: str) -> TrialError:
    shown = text[max(at - 40, 0) : at + 20].replace("\n", " ")
    return TrialError(f"the server sent a message that is no s-expression, at byte {at}: {why}: ...{shown}...")
