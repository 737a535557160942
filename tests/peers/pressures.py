"""Pressures of the same network in OpenPNM, and of the same wells in AnaFlow.

    python -m tests.peers.pressures PYTHON

PYTHON is an interpreter with both (`make peers` makes one). What they answer is kept in
tests/flow/data and tests/analytic/data, so that the test suite repeats the comparison without
them.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from demflow.model.controls import sites
from demflow.model.flow.equation.outputs import outputs
from demflow.model.flow.equation.problem import Problem
from demflow.model.flow.equation.system import System
from demflow.model.flow.solvers.registry import SOLVERS
from demflow.model.region import Rectangle
from demflow.model.scene import Trace, Well
from tests.reservoirs import reservoir
from tests.rocks import random_graph

HERE = Path(__file__).parent
OPENPNM = HERE.parent / "flow" / "data" / "openpnm.npz"
ANAFLOW = HERE.parent / "analytic" / "data" / "anaflow.npz"
HELD, RATE = 1.0, 0.3  # pressure of the left side and rate of the well, in the network's units
ACCURACY = 1e-8  # asked of OpenPNM's integrator
STEPS = (30.0, 100.0, 300.0)  # times over the shortest response time of a pore


def system() -> System:
    """Some 120 pores with a fracture, one side held, a well with storage; conductances near 1."""
    packing = random_graph(1.2, 330, 5)
    packing = packing._replace(radius=0.5 * packing.radius)
    fracture = Trace(
        name="f", aperture=3e-5, start=(-0.6, -0.3), end=(0.7, 0.25), pore_storage="fracture"
    )
    rock = reservoir(packing, Rectangle(2.0, 1.4), 2e-5, (fracture,))
    well = Well(name="w", at=(0.3, 0.2), radius=0.1, rate=1.0, wellbore_storage=1e-11)
    made = rock.assembled(sites((well,)), ("left",))
    flow, store = made.edge_g.mean(), made.storage.mean()
    return made._replace(
        storage=made.storage / store, edge_g=made.edge_g / flow, fixed_g=made.fixed_g / flow
    )


def given(made: System) -> dict[str, np.ndarray]:
    """The network as OpenPNM takes it: one more pore for the side, one pipe for each pair."""
    i = np.concatenate([made.edge_i, made.fixed_node])
    j = np.concatenate([made.edge_j, np.full(len(made.fixed_node), made.n)])
    pairs, which = np.unique(
        np.column_stack([np.minimum(i, j), np.maximum(i, j)]), axis=0, return_inverse=True
    )
    conductance = np.bincount(which.ravel(), weights=np.append(made.edge_g, made.fixed_g))
    return {
        "i": pairs[:, 0],
        "j": pairs[:, 1],
        "conductance": conductance,
        "storage": np.append(made.storage, 1.0),
        "held": np.array([made.n]),
        "held_pressure": np.array([HELD]),
        "wells": made.well_node,
        "rate": np.array([RATE]),
        "times": times(made),
        "accuracy": np.array(ACCURACY),
    }


def taken(network: dict[str, np.ndarray]) -> System:
    """The flow equation of a network as OpenPNM took it."""
    i, j, g = network["i"], network["j"], network["conductance"]
    n = len(network["storage"]) - 1
    rim = j == n  # of each pair the larger number
    empty = np.empty(0, dtype=np.int64)
    return System(
        domain=np.setdiff1d(np.arange(n), network["wells"]),
        n=n,
        storage=network["storage"][:n],
        edge_i=i[~rim],
        edge_j=j[~rim],
        edge_g=g[~rim],
        fixed_node=i[rim],
        fixed_source=np.zeros(np.count_nonzero(rim), dtype=np.int64),
        fixed_g=g[rim],
        short_a=empty,
        short_b=empty,
        short_g=np.empty(0),
        sides=("left",),
        pressure_wells=(),
        rate_wells=(0,),
        well_node=network["wells"],
        node_of_domain=np.arange(n),
        source_of_domain=np.full(n, -1),
        isolated=0,
        initial=np.empty((0, n)),
    )


def times(made: System) -> np.ndarray:
    """Output times."""
    total = np.bincount(made.edge_i, weights=made.edge_g, minlength=made.n) + made.excess
    total += np.bincount(made.edge_j, weights=made.edge_g, minlength=made.n)
    return np.array(STEPS) * float((made.storage / total).min())


def ours(made: System, method: str) -> np.ndarray:
    """Pressure of every unknown by one of our solvers, (times, n) or (1, n)."""
    lag = times(made) if SOLVERS[method].transient else np.array([np.inf])
    problem = Problem(
        system=made,
        records=outputs(made, np.empty(0, dtype=np.int64)),
        lag=lag,
        active=np.ones(2, dtype=bool),
        domain=np.arange(made.n),
        tolerance=1e-10,
        safety_factor=0.05,
    )
    answer = SOLVERS[method].run(problem)
    return HELD * answer.pressure[0] + RATE * answer.pressure[1]


def main(python: str) -> None:
    """Ask both and keep what they say."""
    network = given(system())
    made = taken(network)
    for data in (OPENPNM, ANAFLOW):
        data.parent.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "network.npz"
        np.savez(file, **network)
        subprocess.run([python, HERE / "openpnm_solve.py", file, OPENPNM], check=True)
    subprocess.run([python, HERE / "anaflow_solve.py", ANAFLOW], check=True)
    with np.load(OPENPNM) as kept:
        off = np.abs(kept["steady"][: made.n] - ours(made, "steady")[0]).max()
        print(f"OpenPNM {kept['version']}, {made.n} unknowns: steady apart by {off:.1e}")
        for method in ("krylov", "implicit"):
            off = np.abs(kept["transient"][:, : made.n] - ours(made, method)).max()
            print(f"  transient ({method}) apart by {off:.1e} where it was asked for {ACCURACY:g}")
    with np.load(ANAFLOW) as kept:
        print(f"AnaFlow {kept['version']}: kept {kept['bounded'].size} pressures of each well")


if __name__ == "__main__":
    main(sys.argv[1])
