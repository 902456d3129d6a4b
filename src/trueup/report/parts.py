# SPDX-License-Identifier: Apache-2.0
"""The vocabulary of every report: sections, a headline with facts, tables, remarks, captions, and the page around them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from string import Template

from trueup.report.markup import Child, Markup, escape, join, tag

LISTED = 10
"""Entries of a list that are shown before it says how many more there are."""

Pairs = Iterable[tuple[Child, Child]]
"""Names and what is to be told of each."""


@dataclass(frozen=True)
class Section:
    """One question and its answer."""

    key: str
    """Anchor in the page."""
    short: str
    """For the table of contents."""
    question: str
    body: Markup


def page(
    template: str, title: str, subtitle: Sequence[str], sections: Sequence[Section], *, style: str = "", **more: str
) -> str:
    """The HTML document of a template: its sections, a table of contents, a subtitle of several parts, more style."""
    return Template(template_text(template)).substitute(
        title=escape(title),
        style=template_text("report.css") + style,
        subtitle=escape(" · ".join(filter(None, subtitle))),
        contents=join(tag("a", s.short, href=f"#{s.key}") for s in sections),
        sections=join(tag("section", tag("h2", s.question), s.body, id=s.key) for s in sections),
        **more,
    )


def template_text(name: str) -> str:
    """A file of the templates."""
    return resources.files("trueup.report").joinpath("templates", name).read_text(encoding="utf-8")


def hero(label: str, numbers: Child, *beside: Child, kind: str = "hero") -> Markup:
    """The headline: a number in large type with its label, and what stands beside it."""
    large = tag("div", numbers, class_="hero-numbers")
    return tag(
        "div", tag("div", tag("div", label, class_="hero-label"), large, class_="hero-main"), *beside, class_=kind
    )


def change(before: str, after: str, unit: str) -> Markup:
    """A number before ('' for none) and after, for a headline."""
    parts = (
        (before, "before"),
        (" → " if before else "", "arrow"),
        (after, "after"),
        (f" {unit}" if unit else "", "unit"),
    )
    return join(tag("span", text, class_=kind) for text, kind in parts if text)


def facts(pairs: Pairs, kind: str = "facts") -> Markup:
    """Names with their values, in a list of the style `kind`: facts, hero-facts, legend, doubtful."""
    return tag("dl", [tag("div", tag("dt", name), tag("dd", value)) for name, value in pairs], class_=kind)


def callout(kind: str, title: str, text: str) -> Markup:
    """A framed remark; `kind` is bad, warn or good."""
    role = "alert" if kind == "bad" else None
    return tag("div", tag("strong", title), " ", tag("div", text), class_=f"callout {kind}", role=role)


def cells(*values: Child, kind: str = "number") -> Markup:
    """Cells of a row, each a number unless `kind` says otherwise."""
    return join(tag("td", value, class_=kind or None) for value in values)


def row(name: Child, *rest: Child, **attributes: str | None) -> Markup:
    """A row that begins with its name."""
    return tag("tr", tag("th", name, scope="row"), *rest, **attributes)


def group_row(title: str, width: int) -> Markup:
    """A row that gives a title to those below it, in a table of so many columns."""
    return tag("tr", tag("th", title, colspan=str(width), scope="rowgroup"), class_="group")


def head(*titles: Child, numbers: range | Sequence[int] = range(0)) -> Markup:
    """The row of titles; `numbers` are the columns of numbers."""
    return tag(
        "tr", [tag("th", t, scope="col", class_="number" if i in numbers else None) for i, t in enumerate(titles)]
    )


def table(titles: Markup, rows: Iterable[Markup], kind: str | None = None, **attributes: str | None) -> Markup:
    """A table with its row of titles, in a frame that scrolls where the page is narrow."""
    whole = tag("table", tag("thead", titles) if titles else None, tag("tbody", rows), class_=kind, **attributes)
    return tag("div", whole, class_="scroll")


def context_table(facts_of: Mapping[str, Child]) -> Markup:
    """Where something comes from: names and plain values."""
    return table(Markup(""), [row(name, tag("td", value)) for name, value in facts_of.items()], "context")


def chip(verdict: str, words: str = "", kind: str = "") -> Markup:
    """The verdict as a small coloured label of the style that is named as it, or `kind`."""
    return tag("span", words or verdict, class_=f"chip {(kind or verdict).replace(' ', '-')}")


def caption(text: str) -> Markup:
    """What a figure or table shows."""
    return tag("p", text, class_="caption")


def empty(text: str) -> Markup:
    """That there is nothing to show."""
    return tag("p", text, class_="empty")


def sentences(each: Iterable[str]) -> Markup:
    """Sentences in a list."""
    return tag("ul", [tag("li", sentence) for sentence in each], class_="sentences")


def key(*entries: tuple[str, str]) -> Markup:
    """What the colours of a figure mean."""
    dots = [(tag("b", "● ", style=f"color:var(--{colour})"), words) for colour, words in entries]
    shown = [join(tag("span", *entry, style="white-space:nowrap"), "\u2003 ") for entry in dots]
    return tag("p", shown, class_="key")


def figure(title: Child, *body: Child, note: str = "") -> Markup:
    """A picture with its title above, and a note below."""
    below = tag("figcaption", note, class_="caption") if note else None
    return tag("figure", tag("h4", title) if title else None, *body, below)


def drawn_later(name: str, kind: str = "figure") -> Markup:
    """A place where the script draws a figure."""
    return tag("div", id=f"{name}-figure", class_=kind)
