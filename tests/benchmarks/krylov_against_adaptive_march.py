"""Coupled transients by Krylov against an adaptive TR-BDF2 march with the same factors."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable

import numpy as np

from demflow.model.coupling.krylov import Course, Factors, course
from demflow.model.coupling.march import march
from demflow.model.mechanics.packing.packing import pack
from demflow.model.mechanics.static.stiffness import factorise
from demflow.model.region import Rectangle
from demflow.model.threads import one_blas_thread
from tests.benchmarks.result import Result
from tests.coupling_rocks import APERTURE, VISCOSITY, Specimen, specimen_of

FASTER = {2_000: 5.0, 5_000: 8.0, 20_000: 12.0}  # by grains
ERROR, DECADES, PER_DECADE = 1e-4, 6, 10
MOST_FACTORS, MOST_MEMORY = 25.0, 2.0  # factorisations of K; GB
LADDER = (1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6)


def specimen(count: int) -> Specimen:
    """Random grains between walls, loaded and drained at the top."""
    packing = pack(
        region=Rectangle(1.0, 1.0),
        count=count,
        mean_radius=None,
        packing="random",
        radius_ratio=1.66,
        porosity=0.17,
        seed=1,
        specimen=True,
    )
    return specimen_of(packing, sides=("top",), held=("right",))


def times(rock: Specimen) -> np.ndarray:
    """Six decades from ten times the time in which neighbouring pores even out."""
    radius = rock.rock.frame.unit
    compliance = -rock.drained("top", rock.width)[3] / rock.height
    storage = rock.storage / (rock.width * rock.height) + compliance
    diffusivity = APERTURE**3 / (24.0 * radius) / VISCOSITY / storage
    first = 10.0 * radius**2 / diffusivity
    return np.geomspace(first, first * 10.0**DECADES, DECADES * PER_DECADE + 1)


def cheapest(
    solver: Callable[..., Course], rock: Specimen, lag: np.ndarray, exact: np.ndarray
) -> tuple[float, float, float]:
    """Seconds, error and tolerance of the loosest tolerance that delivers the error."""
    source = rock.rock.unit_load("top", rock.width)
    nothing = np.zeros(len(rock.record.kind))
    size = np.abs(exact).max(axis=0)
    size[size == 0.0] = np.inf
    for tolerance in LADDER:
        start = time.process_time()
        found = solver(Factors(rock.rock), rock.record, source, nothing, lag, tolerance)
        took = time.process_time() - start
        error = float(np.max(np.abs(found.output - exact).max(axis=0) / size))
        if error <= ERROR:
            break
    return took, error, tolerance


def run() -> Result:
    """Ratio of processor times at an error of 1e-4 of all outputs, by size."""
    lines, ratios, costs, holds = [], [], [], True
    with one_blas_thread():
        for count, faster in FASTER.items():
            rock = specimen(count)
            lag = times(rock)
            source = rock.rock.unit_load("top", rock.width)
            nothing = np.zeros(len(rock.record.kind))
            exact = course(Factors(rock.rock), rock.record, source, nothing, lag, 1e-8).output
            start = time.process_time()
            factorise(rock.rock.frame.stiffness)
            own = time.process_time() - start
            took, error, tolerance = cheapest(course, rock, lag, exact)
            slow, slow_error, slow_tolerance = cheapest(march, rock, lag, exact)
            ratios.append(slow / took)
            costs.append(took / own)
            holds &= ratios[-1] >= faster and costs[-1] <= MOST_FACTORS
            holds &= max(error, slow_error) <= ERROR
            lines.append(
                f"{count:,} grains: krylov {took:.3g} s with an error of {error:.1e} at "
                f"{tolerance:g}, march {slow:.3g} s with {slow_error:.1e} at {slow_tolerance:g}; "
                f"{ratios[-1]:.1f} times faster, {costs[-1]:.0f} factorisations of K"
            )
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    lines.append(f"largest memory {memory:.2f} GB")
    return Result(
        f"{', '.join(f'{r:.1f}' for r in ratios)} times faster, {max(costs):.0f} factorisations, "
        f"{memory:.2f} GB",
        f"≥ {', '.join(f'{f:g}' for f in FASTER.values())}, ≤ {MOST_FACTORS:g}, "
        f"≤ {MOST_MEMORY:g} GB",
        bool(holds and memory <= MOST_MEMORY),
        "\n".join(lines),
    )
