"""Names and units of reservoir models in a study; `sweep.analysis.reservoirs` solves them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from demflow.model.parameters import parameter

NAN = math.nan


@dataclass(frozen=True)
class Rock:
    """What is known of reservoir and fluid, and is not fitted.

    The network has its own rock: there only thickness and volume factor count, by which measured
    rates become those of one metre of depth.
    """

    porosity: float = parameter(default=NAN, above=0, at_most=1, help="pore volume over volume")
    viscosity: float = parameter("Pa s", default=NAN, above=0, help="of the fluid")
    compressibility: float = parameter(
        "1/Pa", default=NAN, above=0, example="1e-9 1/Pa", help="total: rock and fluid"
    )
    well_radius: float = parameter("m", default=NAN, above=0, help="radius of the well")
    thickness: float = parameter("m", default=1.0, above=0, help="of the layer")
    volume_factor: float = parameter(
        default=1.0, above=0, help="reservoir over surface volume; the rates are multiplied by it"
    )


class Known(NamedTuple):
    """A parameter of the models."""

    unit: str
    default: float | None  # None: it must be given
    help: str


PARAMETERS: dict[str, Known] = {
    "permeability": Known("m2", None, "of the reservoir"),
    "initial_pressure": Known("Pa", None, "before anything flowed"),
    "skin_factor": Known("1", 0.0, "S of the well"),
    "wellbore_storage": Known("m3/Pa", 0.0, "volume of the well over pressure"),
    "drift": Known("Pa/s", 0.0, "of the gauge"),
    "distance": Known("m", None, "from the well to the boundary"),
    "ratio": Known("1", None, "distance of the farther boundary over that of the nearer"),
    "width": Known("m", None, "of the channel"),
    "offset": Known("1", 0.5, "place of the well across the channel, over its width"),
    "radius": Known("m", None, "of the circle around the well"),
    "area": Known("m2", None, "of the rectangle"),
    "aspect": Known("1", 1.0, "length over width of the rectangle"),
    "offset_along": Known("1", 0.5, "place of the well along the rectangle, over its length"),
    "offset_across": Known("1", 0.5, "place of the well across the rectangle, over its width"),
    "half_length": Known("m", None, "x_f of the fracture"),
    "fracture_conductivity": Known("m3", None, "permeability times width of the fracture"),
    "storativity_ratio": Known("1", None, "ω, the fractures' share of the storage"),
    "interporosity_flow": Known("1", None, "λ, exchange between blocks and fractures"),
}
EVERY = ("permeability", "initial_pressure", "skin_factor", "wellbore_storage", "drift")
_RECTANGLE = ("area", "aspect", "offset_along", "offset_across")
_DOUBLE = ("storativity_ratio", "interporosity_flow")
MODEL_PARAMETERS: dict[str, tuple[str, ...]] = {  # beside those of `EVERY`
    "homogeneous": (),
    "fault": ("distance",),
    "constant_pressure_line": ("distance",),
    "corner": ("distance", "ratio"),
    "channel": ("width", "offset"),
    "closed_circle": ("radius",),
    "constant_pressure_circle": ("radius",),
    "closed_rectangle": _RECTANGLE,
    "constant_pressure_rectangle": _RECTANGLE,
    "double_porosity": _DOUBLE,
    "double_porosity_slabs": _DOUBLE,
    "uniform_flux_fracture": ("half_length",),
    "infinite_conductivity_fracture": ("half_length",),
    "finite_conductivity_fracture": ("half_length", "fracture_conductivity"),
}


def parameters_of(model: str) -> tuple[str, ...]:
    """Names of all parameters of a model."""
    return EVERY + MODEL_PARAMETERS[model]
