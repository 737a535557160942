"""The few pieces of HTML that the report is made of; everything that goes in is escaped."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from html import escape as _escape

from demflow.sweep.analysis.cases import plain_number
from demflow.sweep.printable import printable_lines

__all__ = ["escape", "grid", "visible"]


def visible(text: object) -> str:
    """Text of which nothing goes unseen: what has no shape is shown as its code."""
    return printable_lines(str(text).expandtabs())


def escape(text: object) -> str:
    """Text that a browser shows as it is, in an element or an attribute; nothing of it unseen."""
    return _escape(visible(text), quote=True)


def grid(
    columns: Sequence[str], rows: Iterable[Sequence[object]], caption: str = "", digits: int = 4
) -> str:
    """A table; numbers stand to the right, with so many digits.

    Parameters
    ----------
    columns : heads of the columns
    rows : one sequence of cells a row
    caption : words under it
    digits : significant digits
    """
    head = "".join(f"<th scope='col'>{escape(name)}</th>" for name in columns)
    body = "".join(f"<tr>{''.join(_cell(value, digits) for value in row)}</tr>\n" for row in rows)
    title = f"<caption>{escape(caption)}</caption>" if caption else ""
    return (
        f"<div class='wide' tabindex='0' role='group' aria-label='{escape(caption or 'table')}'>"
        f"<table>{title}<thead><tr>{head}</tr></thead>\n"
        f"<tbody>{body}</tbody></table></div>"
    )


def _cell(value: object, digits: int) -> str:
    if isinstance(value, bool) or not isinstance(value, int | float):
        # a path may break behind its dots rather than within a word
        return f"<td>{re.sub(r'(?<=[._/])(?=[A-Za-z])', '<wbr>', escape(value))}</td>"
    text = "–" if value != value else plain_number(float(value), digits)
    return f"<td class='number'>{escape(text)}</td>"
