"""The few pieces of HTML that the report is made of; everything that goes in is escaped."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape as _escape
from pathlib import Path

from demflow.sweep.analysis.cases import plain_number
from demflow.sweep.printable import printable_lines

__all__ = ["data_uri", "escape", "grid"]


def escape(text: object) -> str:
    """Text that a browser shows as it is, in an element or an attribute; nothing of it unseen."""
    return _escape(printable_lines(str(text).expandtabs()), quote=True)


def grid(
    columns: Sequence[str], rows: Iterable[Sequence[object]], caption: str = "", digits: int = 4
) -> str:
    """A table; numbers stand to the right, with so many digits."""
    head = "".join(f"<th scope='col'>{escape(name)}</th>" for name in columns)
    body = "".join(f"<tr>{''.join(_cell(value, digits) for value in row)}</tr>\n" for row in rows)
    title = f"<caption>{escape(caption)}</caption>" if caption else ""
    return (
        f"<div class='wide'><table>{title}<thead><tr>{head}</tr></thead>\n"
        f"<tbody>{body}</tbody></table></div>"
    )


def _cell(value: object, digits: int) -> str:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return f"<td>{escape(value)}</td>"
    text = "–" if value != value else plain_number(float(value), digits)
    return f"<td class='number'>{escape(text)}</td>"


def data_uri(path: Path) -> str:
    """A PNG file as an address that holds the whole of it."""
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode("ascii")
