"""1,000 held-out members of a family: error at all times against exact solutions, and its bound.

Of every member by dense eigenvectors, of some by eigenvectors in extended precision; apertures
over more than a decade each, drawn between those that the model was made of.
"""

from __future__ import annotations

import numpy as np

from demflow.model.emulation import emulate
from demflow.model.threads import one_blas_thread
from tests.benchmarks.result import Result
from tests.extended import exact
from tests.flow import test_emulator as family
from tests.reservoirs import exact_response

MEMBERS, EXTENDED, TOLERANCE = 1000, 3, 1e-4
DENSE_ROUND_OFF = 1e-9


def run() -> Result:
    """Answer them with one model, and compare the well's pressure at every time."""
    rng = np.random.default_rng(11)
    span = np.log(family.APERTURES[[0, -1]])
    members = [family.fractures(w, v) for w, v in np.exp(rng.uniform(*span, (MEMBERS, 2)))]
    model = family.made("well", tolerance=TOLERANCE)
    with one_blas_thread():
        found = emulate(
            *(family.PACKING, None, family.NETWORK, family.WALK, None, model),
            **family.given("well", members, TOLERANCE),
            wanted=("well_pressure",),
            members=tuple(family.member_of("well", one) for one in members),
        )
        off = np.array([_off(found, k, one) for k, one in enumerate(members)])
    by_model = found["solver_used"] == "emulated"
    bound = found["estimated_error"]
    within = np.mean((off <= TOLERANCE)[by_model])
    beyond = np.count_nonzero((off > bound + DENSE_ROUND_OFF)[by_model])
    precise = max(_off(found, k, members[k], extended=True) / bound[k] for k in range(EXTENDED))
    lines = [
        f"emulated {np.count_nonzero(by_model)} of {MEMBERS} from {model.snapshots} snapshots",
        f"errors: median {np.median(off[by_model]):.2g}, largest {off[by_model].max():.2g}",
        f"bounds: median {np.median(bound[by_model]):.2g}, largest {bound[by_model].max():.2g}",
        f"error over bound in extended precision, of {EXTENDED}: at most {precise:.2g}",
    ]
    holds = within == 1.0 and beyond == 0 and precise <= 1.0 and np.mean(by_model) > 0.9
    told = f"{100 * within:.1f} % within the tolerance, {beyond} beyond their bound"
    return Result(told, "100 %, 0", bool(holds), "\n".join(lines))


def _off(found: dict[str, np.ndarray], k: int, member: tuple, *, extended: bool = False) -> float:
    """Largest error of the well's pressure change over that change, at any time."""
    _, problem = family.posed("well", member)
    source, times = problem.system.fixed_count, np.array(family.TIMES)
    if extended:
        times = times[::8]
        true = exact(problem.system, problem.records, times).output[source, :, 0]
    else:
        true = exact_response(problem.system, source, times)[:, problem.system.well_node[0]]
    seen = found["well_pressure"][k, 0, :: 8 if extended else 1]
    return float(np.max(np.abs(seen / family.WELL.rate / true - 1.0)))
