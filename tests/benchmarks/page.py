"""What the checks found, kept row by row, and the page that shows it."""

from __future__ import annotations

import datetime
import json
import os
import platform
from pathlib import Path
from typing import Any

from tests.benchmarks.result import Result

DOCS = Path(__file__).parents[2] / "docs"
KEPT, PAGE = DOCS / "benchmarks.json", DOCS / "benchmarks.md"


def keep(name: str, title: str, result: Result, names: list[str]) -> None:
    """Take a result into the page in place of an earlier one; drop checks not in `names`."""
    rows: dict[str, Any] = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    rows[name] = {
        "title": title,
        "day": datetime.date.today().isoformat(),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}",
        **result._asdict(),
    }
    rows = {kept: rows[kept] for kept in sorted(rows) if kept in names}
    KEPT.write_text(json.dumps(rows, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    PAGE.write_text(drawn(rows), encoding="utf-8")


def drawn(rows: dict[str, Any]) -> str:
    """The table of all checks, then the details of each."""
    lines = [
        "# Measured claims",
        "",
        "Written by `make bench`; `make bench NAME=…` repeats one of them. Times depend on the "
        "machine; ratios were taken side by side in one run.",
        "",
        "| check | shows | figure | bound | |",
        "|---|---|---|---|---|",
    ]
    for name, row in rows.items():
        verdict = "holds" if row["holds"] else "**falls short**"
        cells = (f"[`{name}`](#{name})", row["title"], row["figure"], row["bound"], verdict)
        lines.append(f"| {' | '.join(cells)} |")
    for name, row in rows.items():
        lines += ["", f"## {name}", "", row["title"], "", f"{row['day']}, {row['machine']}.", ""]
        lines += ["```", row["details"].rstrip(), "```"]
    return "\n".join(lines) + "\n"
