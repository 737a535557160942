"""OpenPNM on a network that is given: steady and transient pressure. Runs where OpenPNM is.

python openpnm_solve.py NETWORK.npz ANSWER.npz
"""

import sys

import numpy as np
import openpnm


def algorithm(kind, given):
    """A transport algorithm of OpenPNM with the given conductances, storage and boundaries."""
    place = np.arange(len(given["storage"]), dtype=float)
    network = openpnm.network.Network(
        conns=np.column_stack([given["i"], given["j"]]),
        coords=np.column_stack([place, 0 * place, 0 * place]),  # of no meaning here
    )
    network["pore.volume"] = given["storage"]
    phase = openpnm.phase.Phase(network=network)
    phase["throat.hydraulic_conductance"] = given["conductance"]
    made = kind(network=network, phase=phase)
    made.settings["quantity"] = "pore.pressure"
    made.settings["conductance"] = "throat.hydraulic_conductance"
    made.set_value_BC(pores=given["held"], values=given["held_pressure"])
    made.set_rate_BC(pores=given["wells"], rates=-given["rate"])
    return made


def main(network, answer):
    """Solve and write."""
    given = dict(np.load(network))
    steady = algorithm(openpnm.algorithms.ReactiveTransport, given)
    steady.run()
    transient = algorithm(openpnm.algorithms.TransientReactiveTransport, given)
    times, accuracy = given["times"], float(given["accuracy"])
    transient.run(
        x0=0.0,
        tspan=(0.0, times[-1]),
        saveat=times,
        integrator=openpnm.integrators.ScipyRK45(rtol=accuracy, atol=accuracy),
    )
    np.savez_compressed(
        answer,
        steady=steady["pore.pressure"],
        transient=np.asarray(transient.soln["pore.pressure"]).T,
        version=openpnm.__version__,
        **{f"given_{name}": value for name, value in given.items()},
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
