"""Draw the pictures of `docs/gallery.md`: one figure of each shipped study, run small.

`python docs/gallery.py [NAME …]` runs the studies with what stands under `smoke:` in them, so that
the pictures show what a study draws and not what it finds.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[1]
FOLDER = Path(__file__).parent / "images" / "gallery"
WIDTH, COLOURS = 760, 96  # of a picture, which is small enough to be kept in Git

SHOWN = {  # study -> its figure
    "quickstart": "well_pressure_producer",
    "field_well": "traces",
    "outcrop": "pressure_map_1",
    "build_up": "horner_producer",
    "fit_build_up": "measured_test",
    "permeability_under_stress": "permeability",
    "stress_closure": "permeability_over",
    "uncertain_rock": "sensitivity",
    "tunnel_inflow": "well_rate",
    "drift_inflow": "forces_0",
    "paper_linear": "compare_linear",
    "paper_fractured": "pressure_map_0",
    "mandel": "settlement",
    "fault_reactivation": "slip",
    "biaxial": "stress_strain",
}


def draw(name: str, results: Path) -> Path:
    """Run a study small, and keep its figure."""
    study = ROOT / "studies" / f"{name}.yaml"
    command = [sys.executable, "-m", "demflow", "run", str(study), "--smoke"]
    subprocess.run([*command, "--results", str(results)], cwd=ROOT, check=False)
    (figure,) = results.glob(f"*/figures/{SHOWN[name]}.png")
    FOLDER.mkdir(exist_ok=True)
    path = FOLDER / f"{name}.png"
    with Image.open(figure) as image:
        small = image.convert("RGB")
        if small.width > WIDTH:
            small = small.resize((WIDTH, round(small.height * WIDTH / small.width)), Image.LANCZOS)
        small.quantize(COLOURS).save(path, optimize=True)
    return path


if __name__ == "__main__":
    for one in sys.argv[1:] or SHOWN:
        with tempfile.TemporaryDirectory() as folder:
            print(draw(one, Path(folder)))
