"""What the checks found, kept row by row, and the page that shows it."""

from __future__ import annotations

import ast
import datetime
import json
import os
import platform
import re
import tempfile
from pathlib import Path
from typing import Any

from tests.benchmarks.result import Result

FOLDER = Path(__file__).parent
DOCS = FOLDER.parents[1] / "docs"
KEPT, PAGE = DOCS / "benchmarks.json", DOCS / "benchmarks.md"


def titles() -> dict[str, str]:
    """What each check shows: the first line of its docstring. A module without `run` is none."""
    found = {}
    for path in sorted(FOLDER.glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        runs = any(isinstance(one, ast.FunctionDef) and one.name == "run" for one in tree.body)
        if runs and not path.stem.startswith("_"):
            found[path.stem] = (ast.get_docstring(tree) or path.stem).splitlines()[0]
    return found


def kept() -> dict[str, Any]:
    """The results that are kept, by the names of their checks."""
    rows: dict[str, Any] = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.exists() else {}
    return rows


def keep(name: str, result: Result) -> None:
    """Take a result in place of an earlier one, drop those of checks that are gone, and write."""
    rows = kept()
    rows[name] = {
        "day": datetime.date.today().isoformat(),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}",
        **result._replace(details=_anywhere(result.details))._asdict(),
    }
    known = titles()
    rows = {one: rows[one] for one in sorted(rows) if one in known}
    KEPT.write_text(json.dumps(rows, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    write()


def _anywhere(text: str) -> str:
    """Words without the folders of the machine on which they were said."""
    temporary = re.escape(tempfile.gettempdir())
    return re.sub(rf"{temporary}/[^/\s]+/", "…/", text.replace(f"{FOLDER.parents[1]}/", ""))


def write() -> None:
    """Write the page from what is kept."""
    PAGE.write_text(drawn(kept(), titles()), encoding="utf-8")


def drawn(rows: dict[str, Any], shown: dict[str, str]) -> str:
    """The table of all checks, those without a kept figure below it, then the details of each."""
    lines = [
        "# Measured claims",
        "",
        "Each check is a module under `tests/benchmarks/`, whose docstring tells its options. "
        "`make bench` repeats them all and writes this page, `make bench NAME=…` repeats one of "
        "them and `python -m tests.benchmarks --keep NAME …` keeps what it finds. Times depend on "
        "the machine and on what else it does; ratios were taken side by side in one run.",
        "",
        "| check | shows | figure | bound | | day |",
        "|---|---|---|---|---|---|",
    ]
    measured = {name: rows[name] for name in shown if name in rows}
    for name, row in measured.items():
        verdict = "holds" if row["holds"] else "**falls short**"
        cells = (f"[`{name}`](#{name})", shown[name], row["figure"], row["bound"], verdict)
        lines.append(f"| {' | '.join((*cells, row['day']))} |")
    lines += ["", "## Checks whose figure is not kept here", ""]
    lines += ["They take long, need other programs or another build, or are newer than this page."]
    lines += ["", "| check | shows |", "|---|---|"]
    lines += [f"| `{name}` | {text} |" for name, text in shown.items() if name not in measured]
    for name, row in measured.items():
        lines += ["", f"## {name}", "", shown[name], "", f"{row['day']}, {row['machine']}.", ""]
        if details := row["details"].rstrip():
            lines += ["```", details, "```"]
    return "\n".join(lines) + "\n"
