"""HTML of a report, put together so that nothing a recording says can become markup.

Whatever is not `Markup` already is escaped where it is put in. Characters that a page cannot hold, or that
turn the direction of the text around them, are shown as a replacement character.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Sequence
from importlib import resources
from typing import Any

MAX_TEXT = 20_000
"""Characters of one text that are shown; a hostile or broken recording may hold megabytes."""

_UNFIT = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff\u200b-\u200f\u202a-\u202e\u2060-\u2069\ufeff\ufffe\uffff]"
)


class Markup(str):
    """HTML that is safe to put into a page as it is."""

    __slots__ = ()


def text(value: Any, limit: int = MAX_TEXT) -> Markup:
    """A value as text, escaped, for content and attributes alike; cut off after `limit` characters."""
    if isinstance(value, Markup):
        return value
    plain = str(value)
    if len(plain) > limit:
        plain = f"{plain[:limit]} ... ({len(plain) - limit} more characters)"
    return Markup(html.escape(_UNFIT.sub("\ufffd", plain), quote=True))


def tag(name: str, /, *content: Any, **attributes: Any) -> Markup:
    """An element. Attributes that are None are left out; `class_` is `class`, `font_size` `font-size`."""
    given = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{text(value)}"'
        for key, value in attributes.items()
        if value is not None
    )
    inside = "".join(text(part) for part in content)
    return Markup(f"<{name}{given}>{inside}</{name}>")


def void(name: str, /, **attributes: Any) -> Markup:
    """An element without content and end: `img`, `meta`."""
    return Markup(tag(name, **attributes).removesuffix(f"</{name}>"))


def joined(parts: Iterable[Any]) -> Markup:
    """Parts one after the other."""
    return Markup("".join(text(part) for part in parts))


def table(head: Sequence[str], rows: Iterable[Sequence[Any]], *, numbers: Iterable[str] = ()) -> Markup:
    """A table that scrolls by itself where the page is narrow; columns in `numbers` are set to the right."""
    right = [name in set(numbers) for name in head]
    body = joined(
        tag("tr", *(tag("td", cell, class_="n" if r else None) for cell, r in zip(row, right, strict=True)))
        for row in rows
    )
    names = tag(
        "tr", *(tag("th", name, class_="n" if r else None) for name, r in zip(head, right, strict=True))
    )
    return tag("div", tag("table", tag("thead", names), tag("tbody", body)), class_="scroll")


def facts(rows: Iterable[tuple[str, Any]]) -> Markup:
    """Names and values, a line each."""
    return tag(
        "table", *(tag("tr", tag("th", name), tag("td", value)) for name, value in rows), class_="facts"
    )


def folded(title: Any, *content: Any, open_: bool = False) -> Markup:
    """Content that is shown on a click; no script is needed for that."""
    return tag("details", tag("summary", title), *content, open="open" if open_ else None)


def section(title: str, *content: Any) -> Markup:
    """A part of the page with its heading; nothing where there is no content."""
    inside = joined(content)
    return tag("section", tag("h2", title), inside) if inside else Markup("")


def page(title: str, *content: Any) -> str:
    """A whole page. It asks for nothing from anywhere: its own policy forbids it."""
    style = resources.files("dssmsg").joinpath("data/report/report.css").read_text("utf-8")
    head = joined(
        (
            void("meta", charset="utf-8"),
            void("meta", name="viewport", content="width=device-width, initial-scale=1"),
            void("meta", http_equiv="Content-Security-Policy", content=_POLICY),
            tag("title", text(title, 200)),
            Markup(f"<style>{style}</style>"),
        )
    )
    return (
        f'<!doctype html>\n<html lang="en"><head>{head}</head><body>{tag("main", *content)}</body></html>\n'
    )


_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
