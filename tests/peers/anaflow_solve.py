"""AnaFlow's pressure falls around wells. Runs where AnaFlow is.

    python anaflow_solve.py ANSWER.npz

Dimensionless as the petroleum field has it: transmissivity and storage 1, rate 2π, radii over
the well's, so that heads are −p_D.
"""

import sys

import anaflow
import numpy as np

RATE = -2.0 * np.pi  # AnaFlow counts production negative
TIMES = np.geomspace(0.1, 1e5, 19)
RADII = np.array([1.0 + 1e-9, 1.5, 4.0, 10.0])  # the wall itself is refused
BOUND = 14.26


def main(answer):
    """Line source, well of radius 1, and the same in a circle of constant pressure."""
    plain = anaflow.theis(TIMES, RADII, storage=1.0, transmissivity=1.0, rate=RATE)
    wide = anaflow.theis(TIMES, RADII, storage=1.0, transmissivity=1.0, rate=RATE, r_well=1.0)
    bounded = anaflow.theis(
        TIMES, RADII, storage=1.0, transmissivity=1.0, rate=RATE, r_well=1.0, r_bound=BOUND
    )
    np.savez_compressed(
        answer,
        times=TIMES,
        radii=RADII,
        bound=BOUND,
        line_source=-plain,
        finite_radius=-wide,
        bounded=-bounded,
        version=anaflow.__version__,
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
