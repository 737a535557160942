"""Wells from a hundredth of a pore to three pores wide, anywhere, against the continuum.

Drawdown at a unit rate over that of a disc with its rim at a constant pressure, with the
permeability of the whole network: a well at ρ has arcosh((R² + r_w² − ρ²) / (2 R r_w)) μ / 2πk.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from demflow.model.analytic.wellbore import well_with_storage_and_skin
from demflow.model.mechanics.packing.packing import pack
from demflow.model.permeability import permeability
from demflow.model.region import Circle
from demflow.model.scene import Well
from tests.benchmarks.result import Result
from tests.reservoirs import Reservoir, reservoir
from tests.rocks import hexagonal_lattice, square_lattice

DISC = Circle(1.0)
WIDTHS = (0.01, 0.1, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0)  # r_w over the spacing of the pores
PLACES, AT_RIM = 40, 20
VISCOSITY = 1e-3


def packings() -> Iterator[tuple[str, object]]:
    """Six random packings of two sizes, and the two lattices off their lucky places."""
    for count in (1500, 5000):
        for seed in (1, 2, 3):
            made = pack(
                region=DISC, count=count, mean_radius=None, packing="random",
                radius_ratio=1.66, porosity=0.16, seed=seed,
            )  # fmt: skip
            yield "random", made
    yield "hexagonal", hexagonal_lattice(1.1, 1 / 60, (0.003, 0.002))
    yield "square", square_lattice(1.1, 1 / 60, (0.003, 0.002))


def spacing(rock: Reservoir) -> float:
    """Root of the mean area of a pore, m."""
    return math.sqrt(rock.network.area[rock.network.inside].mean())


def transmits(rock: Reservoir) -> float:
    """2π k/μ of the whole, m³/(s Pa)."""
    tensor = permeability(rock.network, rock.apertures, viscosity=VISCOSITY) / VISCOSITY
    return 2 * math.pi * math.sqrt(np.linalg.det(tensor))


def fall(rock: Reservoir, at: complex, radius: float) -> float:
    """Fall of the pressure of a well at a unit rate, the rim at zero, Pa."""
    well = Well(name="w", at=(at.real, at.imag), radius=radius, rate=1.0)
    seen = rock.observed((well,), (("outer", 0.0),), method="steady", record_map=False)
    return -float(seen["well_pressure"][0])


def in_a_disc(at: complex, radius: float) -> float:
    """2π k/μ times that of the continuum."""
    return math.acosh((1 + radius**2 - abs(at) ** 2) / (2 * radius))


def errors(rock: Reservoir, places: int, rng: np.random.Generator) -> dict[str, list[float]]:
    """Relative errors in one packing, by what they are of."""
    h, unit = spacing(rock), transmits(rock)
    found: dict[str, list[float]] = {f"r_w/h {ratio:g}": [] for ratio in WIDTHS}
    found["beside the rim"] = []
    for _ in range(places):
        at = 0.75 * math.sqrt(rng.uniform()) * np.exp(2j * math.pi * rng.uniform())
        for ratio in WIDTHS:
            off = fall(rock, at, ratio * h) * unit / in_a_disc(at, ratio * h) - 1
            found[f"r_w/h {ratio:g}"].append(off)
    for number in range(AT_RIM):
        at = (1 - h * rng.uniform(0.5, 2.0)) * np.exp(2j * math.pi * rng.uniform())
        radius = (0.01, 0.1, 0.3)[number % 3] * h
        found["beside the rim"].append(fall(rock, at, radius) * unit / in_a_disc(at, radius) - 1)
    return found


def transient_errors(rock: Reservoir) -> list[float]:
    """Relative errors of a well in the middle with storage and a skin, from when pores settle."""
    unit, found = transmits(rock), []
    h, porosity, c = spacing(rock), float(rock.network.porosity), 1 / rock.bulk_modulus
    for ratio, skin in ((0.1, 5.0), (0.5, 2.0), (2.0, 0.0), (2.0, -1.0)):
        radius = ratio * h
        acts = radius * math.exp(max(0.0, -skin))
        storage = 100 * 2 * math.pi * porosity * c * acts**2
        second = 2 * math.pi * porosity * c * acts**2 / unit  # of t_D = 1
        t_D = np.geomspace(20 * max(1.0, (h / acts) ** 2), 1e3 / acts**2, 12)
        well = Well(
            name="w", at=(0.0, 0.0), radius=radius, rate=1.0, skin_factor=skin,
            wellbore_storage=storage,
        )  # fmt: skip
        seen = rock.observed(
            (well,), (("outer", 0.0),), 0.0, tuple(t_D * second), tolerance=1e-6, record_map=False
        )
        expected = well_with_storage_and_skin(t_D, 100.0, max(skin, 0.0), R_De=1 / acts)
        found += (-seen["well_pressure"][0] * unit / expected - 1).tolist()
    return found


def run() -> Result:
    """Mean, standard deviation and largest of the errors, of each width and kind of packing."""
    rng = np.random.default_rng(7)
    every: dict[str, list[float]] = {}
    for name, packing in packings():
        rock = reservoir(packing, DISC)
        places = PLACES if name == "random" else PLACES // 4
        for what, off in errors(rock, places, rng).items():
            every.setdefault(f"{name}, {what}", []).extend(off)
        every.setdefault(f"{name}, transient", []).extend(transient_errors(rock))
    lines, holds = [], True
    worst = {"mean": 0.0, "deviation": 0.0, "largest": 0.0, "rim": 0.0, "transient": 0.0}
    for what, off in every.items():
        values = np.array(off)
        mean, deviation, most = values.mean(), values.std(), np.abs(values).max()
        lines.append(
            f"{what:32s} mean {100 * mean:+.2f} ± {100 * deviation / math.sqrt(len(off)):.2f} %, "
            f"deviation {100 * deviation:.2f} %, at worst {100 * most:.2f} %, {len(off)} wells"
        )
        if "transient" in what:
            worst["transient"] = max(worst["transient"], abs(mean))
        elif "rim" in what:
            worst["rim"] = max(worst["rim"], most)
        else:
            worst["mean"] = max(worst["mean"], abs(mean))
            worst["deviation"] = max(worst["deviation"], deviation)
            worst["largest"] = max(worst["largest"], most)
    bounds = {"mean": 0.02, "deviation": 0.03, "largest": 0.08, "rim": 0.10, "transient": 0.03}
    holds = all(worst[key] <= bounds[key] for key in bounds)
    return Result(
        f"mean {100 * worst['mean']:.2f} %, deviation {100 * worst['deviation']:.2f} %, worst "
        f"{100 * worst['largest']:.2f} %; beside a rim {100 * worst['rim']:.2f} %; transient mean "
        f"{100 * worst['transient']:.2f} %",
        "≤ 2, 3, 8 %; ≤ 10 %; ≤ 3 %",
        holds,
        "\n".join(lines),
    )
