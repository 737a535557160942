"""What the checker of the Climate and Forecast conventions says of a netCDF file."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

CHECK = """
import sys
from compliance_checker.runner import CheckSuite, ComplianceChecker
CheckSuite.load_all_available_checkers()
ComplianceChecker.run_checker(sys.argv[1], ['cf:1.11'], 0, 'normal',
    output_format=['json'], output_filename=sys.argv[2])
"""


def complaints(path: Path, report: Path) -> list[str]:
    """All that it finds wrong with a file, of any priority; its report goes to another file."""
    command = [sys.executable, "-c", CHECK, str(path), str(report)]
    subprocess.run(command, capture_output=True, check=True)
    found = json.loads(report.read_text())["cf:1.11"]
    assert found["high_priorities"]  # it has checked something
    return [
        message
        for level in ("high_priorities", "medium_priorities", "low_priorities")
        for check in found[level]
        for message in check["msgs"]
    ]
