"""Steady flow at a contrast of 1e12 is right in every pore, as fracture and as barrier."""

from __future__ import annotations

import numpy as np

from demflow.model.controls import sites
from demflow.model.flow.equation.balance import STAGNANT, steady_flow
from demflow.model.flow.linear.factor import analyse, factorise, solve
from tests.benchmarks.contrasts import SIDES, WELL, cut, pores, reference, residual
from tests.benchmarks.result import Result

CONTRAST = 1e12
SIZES = (1_000, 10_000, 100_000, 1_000_000)
DENSE = 2_000  # pores of a network that is compared with extended precision
PRESSURE, WHOLE, PORE = 1e-13, 1e-13, 1e-9


def run() -> Result:
    """Pressures, balance of the whole and of each pore, for a unit of each source.

    Pressures are compared with a dense elimination in extended precision, where that can be
    had; where not, their error is bounded by K⁻¹|r|, r what does not balance in each pore
    when flows are summed along edges in extended precision. Balances are the worse of what
    these flows show, each no more than its conductance times the difference of the two-part
    pressures at its ends, and of what a user sees: `mass_balance_error` of the whole, and
    `residual`, before anything was drained, of each pore over the flow through it (or, in
    stagnant pores, over 1e-15 of the flow through the whole).
    """
    worst = np.zeros(3)
    lines = []
    for size in SIZES:
        rock = pores(size)
        for kind in ("fracture", "barrier"):
            reservoir = cut(rock, kind, CONTRAST)
            system = reservoir.assembled(sites((WELL,)), tuple(name for name, _ in SIDES))
            factor = factorise(
                analyse(system.n, system.edge_i, system.edge_j), system.edge_g, system.excess
            )
            off = whole = pore = 0.0
            for source in range(system.source_count):
                rhs = system.source(source)
                found = steady_flow(system, factor, source)
                rest, through = residual(system, source, found.pressure, found.remainder)
                moved = float(np.abs(found.link).sum() + np.abs(rhs[system.well_node]).sum())
                whole = max(whole, abs(float(rest.sum())) / moved)
                passes = np.maximum(through, STAGNANT * moved)
                pore = max(pore, float(np.max(np.abs(rest) / passes)))
                if system.n < DENSE:
                    exact = reference(system, rhs)
                    error = np.abs(found.pressure - exact) / np.abs(exact)
                else:
                    error = solve(factor, np.abs(rest).astype(float)) + np.abs(found.remainder)
                    error = error / np.abs(found.pressure)
                off = max(off, float(error.max()))
            seen = reservoir.observed((WELL,), SIDES, method="steady", record_map=False)
            told = float(seen["mass_balance_error"]), float(seen["residual"])
            worst = np.maximum(worst, [off, max(whole, told[0]), max(pore, told[1])])
            lines.append(
                f"{kind}, {system.pores} pores: pressure {off:.1e}, whole {whole:.1e} "
                f"(a study says {told[0]:.1e}), pore {pore:.1e} (a study says {told[1]:.1e})"
            )
    return Result(
        "pressure {:.1e}, whole {:.1e}, pore {:.1e}".format(*worst),
        f"≤ {PRESSURE:g}, ≤ {WHOLE:g}, ≤ {PORE:g}",
        bool(np.all(worst <= [PRESSURE, WHOLE, PORE])),
        "\n".join(lines),
    )
