"""Reservoir models by name: from a well's rates to its pressure, in SI.

Each is a solution in Laplace space (`model.analytic`) with wellbore storage and skin, inverted on a
grid of times and superposed over the changes of the rate. A negative skin is a larger well.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, RectBivariateSpline

from demflow.model.analytic.boundaries import (
    CONSTANT,
    SEALED,
    Side,
    with_double_porosity,
    with_sides,
)
from demflow.model.analytic.fractures import (
    EQUIVALENT_PLACE,
    finite_conductivity_transform,
    uniform_flux_transform,
)
from demflow.model.analytic.laplace import Transform, invert
from demflow.model.analytic.radial import bounded_transform, closed_transform, unbounded_transform
from demflow.model.analytic.wellbore import with_storage_and_skin
from demflow.sweep.analysis.fitting import Fit, Free, fit
from demflow.sweep.study.reservoir import MODEL_PARAMETERS, PARAMETERS, Rock, parameters_of

TABLED_S, TABLED_F_CD = (1e-9, 1e11), (1e-4, 1e7)  # of a fracture's responses
PER_DECADE = 16  # times of the grid on which a response is inverted; the spline is off by 1e-6
LEVEL = "initial_pressure"
Rates = Sequence[tuple[float, float]]


Values = Mapping[str, float]


class Model(NamedTuple):
    """A reservoir model: p̄_D(s) in units of its length, as `sweep.study.reservoir` names it."""

    title: str
    transform: Callable[[Values, float], Transform]  # of the values and the length, m
    fractured: bool = False  # its length is x_f
    nodes: int = 16  # an error of 4e-10, below what any gauge sees


def _fault(reflection: float) -> Callable[[Values, float], Transform]:
    def transform(v: Values, length: float) -> Transform:
        return with_sides(unbounded_transform(1.0), Side(v["distance"] / length, reflection))

    return transform


def _corner(v: Values, length: float) -> Transform:
    west, south = Side(v["distance"] / length), Side(v["ratio"] * v["distance"] / length)
    return with_sides(unbounded_transform(1.0), west=west, south=south)


def _channel(v: Values, length: float) -> Transform:
    near, far = (share * v["width"] / length for share in (v["offset"], 1.0 - v["offset"]))
    return with_sides(unbounded_transform(1.0), Side(near), Side(far))


def _rectangle(reflection: float) -> Callable[[Values, float], Transform]:
    def transform(v: Values, length: float) -> Transform:
        across = math.sqrt(v["area"] / v["aspect"]) / length
        along = across * v["aspect"]
        x, y = v["offset_along"], v["offset_across"]
        places = (x * along, (1.0 - x) * along, y * across, (1.0 - y) * across)
        sides = [Side(place, reflection) for place in places]
        return with_sides(unbounded_transform(1.0), *sides)

    return transform


def _double(slabs: bool) -> Callable[[Values, float], Transform]:
    def transform(v: Values, length: float) -> Transform:
        # λ counts in r_w², and the length of a stimulated well is larger
        scaled = v["interporosity_flow"] * (length / v["_well_radius"]) ** 2
        return with_double_porosity(
            unbounded_transform(1.0), v["storativity_ratio"], scaled, slabs=slabs
        )

    return transform


def _finite(v: Values, length: float) -> Transform:
    F_CD = v["fracture_conductivity"] / (v["permeability"] * length)

    def transform(s: np.ndarray) -> np.ndarray:
        size = np.abs(s)
        inside = TABLED_S[0] < size.min() and size.max() < TABLED_S[1]
        if not (inside and TABLED_F_CD[0] < F_CD < TABLED_F_CD[1]):
            return finite_conductivity_transform(F_CD)(s)
        found = np.empty_like(s)
        # s = z / t: the points of the contour stay on their rays from zero
        for k, direction in enumerate(s.reshape(-1, s.shape[-1])[0]):
            height, turn = _on_a_ray(round(float(np.angle(direction)), 12))
            at = np.log(size[..., k]), math.log(F_CD)
            found[..., k] = np.exp(height.ev(*at) + 1j * turn.ev(*at)) / s[..., k]
        return found

    return transform


@cache
def _on_a_ray(angle: float) -> tuple[RectBivariateSpline, RectBivariateSpline]:
    """Parts of ln(s p̄_D) of a fracture over ln |s| and ln F_CD, on a ray of s; to 2e-5.

    A fit asks for thousands of responses: they all lie on the rays of one contour.
    """
    at = [
        np.linspace(math.log(low), math.log(high), 1 + round(per * math.log10(high / low)))
        for low, high, per in ((*TABLED_S, 8), (*TABLED_F_CD, 8))
    ]
    s = np.exp(at[0] + 1j * angle)
    heights = np.log(s * finite_conductivity_transform(np.exp(at[1]))(s)).T
    real, imaginary = (
        RectBivariateSpline(*at, part, kx=5, ky=5) for part in (heights.real, heights.imag)
    )
    return real, imaginary


MODELS: dict[str, Model] = {
    "homogeneous": Model("unbounded", lambda v, length: unbounded_transform(1.0)),
    "fault": Model("one sealing fault", _fault(SEALED)),
    "constant_pressure_line": Model("one straight side at constant pressure", _fault(CONSTANT)),
    "corner": Model("two faults at right angles", _corner),
    "channel": Model("between two parallel faults", _channel),
    "closed_circle": Model(
        "closed circle", lambda v, length: closed_transform(1.0, v["radius"] / length)
    ),
    "constant_pressure_circle": Model(
        "circle at constant pressure",
        lambda v, length: bounded_transform(1.0, v["radius"] / length),
    ),
    "closed_rectangle": Model("closed rectangle", _rectangle(SEALED)),
    "constant_pressure_rectangle": Model("rectangle at constant pressure", _rectangle(CONSTANT)),
    "double_porosity": Model("double porosity, pseudo-steady exchange", _double(slabs=False)),
    "double_porosity_slabs": Model(
        "double porosity, transient exchange with slabs", _double(slabs=True)
    ),
    "uniform_flux_fracture": Model(
        "fracture with an even inflow", lambda v, length: uniform_flux_transform(), fractured=True
    ),
    "infinite_conductivity_fracture": Model(
        "fracture without resistance",
        lambda v, length: uniform_flux_transform(EQUIVALENT_PLACE),
        fractured=True,
    ),
    "finite_conductivity_fracture": Model(
        "fracture that resists the flow along it", _finite, fractured=True, nodes=12
    ),
}
assert MODELS.keys() == MODEL_PARAMETERS.keys()


def unit_response(model: Model, rock: Rock, values: Values, times: ArrayLike) -> np.ndarray:
    """Fall of the pressure after a time at the surface rate 1 m³/s, Pa, of the shape of `times`.

    Parameters
    ----------
    model : well, reservoir and boundaries
    rock : what is known of rock and fluid
    values : SI, every name of `sweep.study.reservoir.parameters_of`.
    times : above zero, s.

    Raises
    ------
    ValueError : values that the model has no meaning for (a fault within the well).
    """
    times = np.asarray(times, dtype=float)
    v = {**values, "_well_radius": rock.well_radius}
    skin = max(v["skin_factor"], 0.0)
    if model.fractured:
        length = v["half_length"]
    else:
        length = rock.well_radius * math.exp(-min(v["skin_factor"], 0.0))
    volume = 2.0 * math.pi * rock.porosity * rock.compressibility * rock.thickness * length**2
    diffusivity = v["permeability"] / (rock.porosity * rock.viscosity * rock.compressibility)
    whole = with_storage_and_skin(model.transform(v, length), v["wellbore_storage"] / volume, skin)
    scale = rock.viscosity * rock.volume_factor
    scale /= 2.0 * math.pi * v["permeability"] * rock.thickness
    return scale * invert(whole, times * diffusivity / length**2, model.nodes)


class Response:
    """A unit response by a spline in the logarithms of time and pressure, on a fixed grid."""

    def __init__(self, lags: np.ndarray):
        self.lags = lags
        low, high = math.log(lags.min()), math.log(lags.max())
        count = max(8, math.ceil((high - low) / math.log(10.0) * PER_DECADE) + 1)
        few = len(lags) <= count
        self.grid = np.unique(lags) if few else np.exp(np.linspace(low, high, count))
        self.exact = few

    def at(self, model: Model, rock: Rock, values: Values) -> np.ndarray:
        """Response at each lag, Pa s/m³.

        Parameters
        ----------
        model : well, reservoir and boundaries
        rock : what is known of rock and fluid
        values : SI, every name of the model’s parameters
        """
        found = unit_response(model, rock, values, self.grid)
        if self.exact:
            return found[np.searchsorted(self.grid, self.lags)]
        if not np.all(found > 0.0):
            raise ValueError("the response is not positive")
        spline = CubicSpline(np.log(self.grid), np.log(found))
        result: np.ndarray = np.exp(spline(np.log(self.lags)))
        return result


class Superposed:
    """Pressure at given times for given rates, by any model; made once, asked often."""

    def __init__(self, times: ArrayLike, rates: Rates):
        self.times = np.asarray(times, dtype=float)
        start, rate = np.asarray(rates, dtype=float).reshape(-1, 2).T
        step = np.diff(rate, prepend=0.0)
        age = self.times[:, None] - start
        self._row, which = np.nonzero((age > 0.0) & (step != 0.0))
        self._step = step[which]
        if not len(which):
            raise ValueError("nothing flows before the last time")
        self._response = Response(age[self._row, which])

    def pressure(self, model: Model, rock: Rock, values: Values) -> np.ndarray:
        """Pa, at each time.

        Parameters
        ----------
        model : well, reservoir and boundaries
        rock : what is known of rock and fluid
        values : SI, every name of the model’s parameters
        """
        fall = self._response.at(model, rock, values) * self._step
        total = np.bincount(self._row, fall, minlength=len(self.times))
        return values["initial_pressure"] + values["drift"] * self.times - total


def fit_model(
    name: str,
    rock: Rock,
    record: tuple[np.ndarray, np.ndarray],
    rates: Rates,
    free: Mapping[str, tuple[float, float]],
    known: Values,
    *,
    profile: bool | None = None,
) -> Fit:
    """Fit a model to measured pressures.

    Parameters
    ----------
    name : of the model, one of `MODELS`.
    rock : what is known of rock and fluid
    record : times, s, and pressures, Pa, (n,) each.
    rates : (time, new rate) of the well, s and m³/s.
    free : bounds of what is fitted, SI.
    known : other parameters of the model, SI.
    profile : intervals by profile likelihood, as for `fitting.fit`.

    Raises
    ------
    ValueError : no such model, a parameter that it does not have, or one that lacks a value.
    """
    if name not in MODELS:
        raise ValueError(f"there is no model {name}; there are {', '.join(MODELS)}")
    own = parameters_of(name)
    if strange := [key for key in (*free, *known) if key not in own]:
        raise ValueError(f"{name} has no {strange[0]}; it has {', '.join(own)}")
    fixed = {key: PARAMETERS[key].default for key in own} | dict(known)
    if lacking := [key for key in own if key not in free and fixed[key] is None]:
        raise ValueError(f"{', '.join(lacking)} must be fitted or known")
    times, pressure = record
    well, model = Superposed(times, rates), MODELS[name]

    def predict(values: Values) -> np.ndarray:
        told = {key: value for key, value in fixed.items() if value is not None}
        return well.pressure(model, rock, {**told, **values})

    bounds = [Free(key, *ends) for key, ends in free.items()]
    return fit(predict, pressure, bounds, level=LEVEL, profile=profile)
