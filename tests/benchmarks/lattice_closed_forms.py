"""Square and hexagonal lattices through the whole model have their closed-form k and porosity."""

from __future__ import annotations

import math

import numpy as np

from demflow.model import simulate
from demflow.model.scene import Circle, Fluid, Grains, Matrix, Polygon, Rectangle, Scene
from tests.benchmarks.result import Result, at_most

APERTURE = 2e-5
RADIUS = 0.11
REGIONS = {
    "rectangle": Rectangle(4.0, 3.0),
    "circle": Circle(2.0),
    "polygon": Polygon(((-2.0, -1.5), (2.2, -1.0), (0.3, 2.4))),
}
FORMS = {
    "square": (APERTURE**3 / (24 * RADIUS), 1 - math.pi / 4),
    "hexagonal": (APERTURE**3 / (24 * math.sqrt(3) * RADIUS), 1 - math.pi / (2 * math.sqrt(3))),
}


def run() -> Result:
    """Largest relative error over lattices and regions."""
    worst, lines = 0.0, []
    for packing, (k, porosity) in FORMS.items():
        for shape, region in REGIONS.items():
            found = simulate(
                Scene(
                    region=region,
                    grains=Grains(packing=packing, mean_radius=RADIUS),
                    matrix=Matrix(aperture=APERTURE),
                    fluid=Fluid(viscosity=1e-3, bulk_modulus=2e9),
                    observe=("permeability",),
                )
            )
            error_k = np.abs(found["permeability"] / k - np.eye(2)).max()
            error_porosity = abs(found["porosity"] / porosity - 1)
            worst = max(worst, error_k, error_porosity)
            lines.append(f"{packing:9} {shape:9} k {error_k:.1e}  porosity {error_porosity:.1e}")
    return at_most(worst, 1e-10, "largest relative error", "\n".join(lines))
