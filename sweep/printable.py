"""Text that others wrote, made fit for a terminal, a page, a file name or an attribute.

Names and values of a study, and names of files, may hold what nobody sees and what a terminal
obeys: escape sequences, marks that turn the direction of writing, halves of characters that no
encoding takes. They are shown as what they are.
"""

from __future__ import annotations


def printable(text: str) -> str:
    r"""Return a text with everything that cannot be seen as its escape: ESC is `\x1b`.

    That is all that `str.isprintable` refuses: control and format characters, line ends,
    spaces other than the blank, lone surrogates, code points that are not assigned.
    """
    if text.isprintable():
        return text
    return "".join(one if one.isprintable() else repr(one)[1:-1] for one in text)


def printable_lines(text: str) -> str:
    """Return a text of several lines, each made printable."""
    return "\n".join(map(printable, text.split("\n")))


def shortened(text: str, most: int) -> str:
    """Return a text of at most so many characters, what was in its middle left out."""
    if len(text) <= most:
        return text
    kept = most - 3
    return f"{text[: kept - kept // 2]} … {text[len(text) - kept // 2 :]}"
