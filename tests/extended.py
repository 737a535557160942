"""Step responses of a flow system in extended precision, by its eigenvectors.

Everything that is summed or solved is a number of 128 bits, so that conductances twelve decades
apart leave no trace of round-off: twice as many bits move no value by 1e-22 of the largest, in
tight rock neither. Slow, obvious, and it shares nothing with the solvers but the
list of conductances; for networks of some tens to two hundred pores.
"""

from __future__ import annotations

from typing import NamedTuple

import flint
import numpy as np

from demflow.model.controls import Controls, step_sizes
from demflow.model.flow.equation.outputs import Records
from demflow.model.flow.equation.system import System

BITS = 128
ZERO = flint.arb(0)
MOST_STEPS = 8  # that put eigenvectors right


class Exact(NamedTuple):
    """Unit step responses of every source, extended to what a long double holds."""

    lag: np.ndarray  # (l,) s
    output: np.ndarray  # (sources, l, o), as `Responses.output`
    pressure: np.ndarray  # (sources, l, n) of all unknowns


def _matrix(rows: int, columns: int) -> list[list[flint.arb]]:
    return [[flint.arb(0)] * columns for _ in range(rows)]


def _laplacian(system: System) -> list[list[flint.arb]]:
    """G of all unknowns, summed edge by edge."""
    G = _matrix(system.n, system.n)
    for i, j, g in zip(system.edge_i, system.edge_j, system.edge_g, strict=True):
        g = flint.arb(float(g))
        G[i][i] += g
        G[j][j] += g
        G[i][j] -= g
        G[j][i] -= g
    for i, g in zip(system.fixed_node, system.fixed_g, strict=True):
        G[i][i] += flint.arb(float(g))
    return G


def _loads(system: System) -> flint.arb_mat:
    """Right-hand sides of all sources but initial fields, (n, sources)."""
    count = system.fixed_count + len(system.rate_wells)
    load = _matrix(system.n, count)
    for i, k, g in zip(system.fixed_node, system.fixed_source, system.fixed_g, strict=True):
        load[i][k] += flint.arb(float(g))
    for well, node in enumerate(system.well_node):
        load[node][system.fixed_count + well] -= 1
    return flint.arb_mat(load)


def _grown(decay: flint.arb, lag: float) -> flint.arb:
    """(1 − e^(−λt)) / λ."""
    z = decay * flint.arb(lag)
    if abs(float(z)) < 1e-60:
        return flint.arb(lag)
    return -(-z).expm1() / decay


def _long(values: flint.arb_mat) -> np.ndarray:
    """As long doubles, from two parts."""
    found = np.empty((values.nrows(), values.ncols()), dtype=np.longdouble)
    for i in range(values.nrows()):
        for j in range(values.ncols()):
            head = float(values[i, j])
            found[i, j] = np.longdouble(head) + np.longdouble(float(values[i, j] - head))
    return found


def exact(system: System, records: Records, lag: np.ndarray) -> Exact:
    """Responses to a unit step of every source, at every lag."""
    before = flint.ctx.prec
    flint.ctx.prec = BITS
    try:
        return _exact(system, records, lag)
    finally:
        flint.ctx.prec = before


def _middle(values: flint.arb_mat) -> flint.arb_mat:
    """Without the bounds of the error, which would grow for nothing."""
    return flint.arb_mat(values.nrows(), values.ncols(), [v.mid() for v in values.entries()])


def _modes(matrix: flint.arb_mat) -> tuple[list[flint.arb], flint.arb_mat]:
    """Eigenvalues and eigenvectors of a symmetric matrix.

    Those in doubles, Q, put right: what Q⁻¹ A Q has off its diagonal is taken away to first order,
    which squares it, until nothing is left. Where eigenvalues lie too close together for that, by
    the QR algorithm, which takes ten times as long.
    """
    n = matrix.nrows()
    doubles = np.array([float(v) for v in matrix.entries()]).reshape(n, n)
    modes = flint.arb_mat(np.linalg.eigh(doubles)[1].tolist())
    worst = 1.0
    for _ in range(MOST_STEPS):
        turned = modes.solve(matrix * modes, algorithm="approx")
        rows = turned.tolist()
        decay = [rows[i][i] for i in range(n)]
        if worst < 2.0 ** (-0.4 * BITS):
            return decay, modes
        off = [
            [rows[i][j] / (decay[j] - decay[i]) if i != j else ZERO for j in range(n)]
            for i in range(n)
        ]
        worst = max(abs(float(v)) for row in off for v in row)
        if worst > 0.1:
            break
        modes = _middle(modes + modes * _middle(flint.arb_mat(off)))
    values, right = flint.acb_mat(matrix).eig(right=True, algorithm="approx")
    modes = flint.arb_mat([[right[i, j].real.mid() for j in range(n)] for i in range(n)])
    return [v.real.mid() for v in values], modes


def _exact(system: System, records: Records, lag: np.ndarray) -> Exact:
    n, m = system.n, system.pores
    G, load = _laplacian(system), _loads(system)
    sources = load.ncols()
    wells = n - m
    pores = flint.arb_mat([row[:m] for row in G[:m]])
    rhs = flint.arb_mat([[load[i, k] for k in range(sources)] for i in range(m)])
    if wells:
        across = flint.arb_mat([row[m:] for row in G[:m]])
        inner = flint.arb_mat([row[m:] for row in G[m:]])
        top = flint.arb_mat([[load[i, k] for k in range(sources)] for i in range(m, n)])
        pores = pores - across * inner.solve(across.transpose())
        rhs = rhs - across * inner.solve(top)
    root = [flint.arb(float(c)).sqrt() for c in system.storage[:m]]
    scaled = flint.arb_mat(
        [[pores[i, j] / (root[i] * root[j]) for j in range(m)] for i in range(m)]
    )
    decay, modes = _modes(scaled)
    driven = flint.arb_mat([[rhs[i, k] / root[i] for k in range(sources)] for i in range(m)])
    weight = _middle(modes.solve(_middle(driven), algorithm="approx"))
    grown = [[_grown(decay[i], float(t)) for t in lag] for i in range(m)]

    output = np.empty((sources, len(lag), records.rows.shape[0]), dtype=np.longdouble)
    pressure = np.empty((sources, len(lag), n), dtype=np.longdouble)
    for k in range(sources):
        moved = flint.arb_mat(
            [[(grown[i][t] * weight[i, k]).mid() for t in range(len(lag))] for i in range(m)]
        )
        field = _middle(modes * moved)
        field = flint.arb_mat([[field[i, t] / root[i] for t in range(len(lag))] for i in range(m)])
        if wells:
            own = flint.arb_mat([[top[w, k]] * len(lag) for w in range(wells)])
            at_wells = inner.solve(own - across.transpose() * field)
            field = _stacked(field, at_wells)
        pressure[k] = _long(field).T
        output[k] = _long(_outputs(system, records, k, field)).T
    return Exact(lag, output, pressure)


def _stacked(upper: flint.arb_mat, lower: flint.arb_mat) -> flint.arb_mat:
    rows = [[a[i, j] for j in range(a.ncols())] for a in (upper, lower) for i in range(a.nrows())]
    return flint.arb_mat(rows)


def _outputs(system: System, records: Records, source: int, field: flint.arb_mat) -> flint.arb_mat:
    """Wells, inflows from differences of pressure, probes, (o, l)."""
    lags = field.ncols()
    found = _matrix(records.rows.shape[0], lags)
    for well, node in enumerate(system.well_node):
        found[well] = [field[int(node), t] for t in range(lags)]
    first = records.well_rows
    for i, k, g in zip(system.fixed_node, system.fixed_source, system.fixed_g, strict=True):
        held = 1 if k == source else 0
        g, row = flint.arb(float(g)), first + int(k)
        found[row] = [found[row][t] + g * (held - field[int(i), t]) for t in range(lags)]
    for a, b, g in zip(system.short_a, system.short_b, system.short_g, strict=True):
        through = flint.arb(float(g)) * (int(a == source) - int(b == source))
        found[first + int(a)] = [v + through for v in found[first + int(a)]]
        found[first + int(b)] = [v - through for v in found[first + int(b)]]
    rows = records.rows.tocsr()
    for o in range(first + records.flow_rows, records.rows.shape[0]):
        found[o] = [flint.arb(float(records.direct[source, o]))] * lags
        entries = slice(rows.indptr[o], rows.indptr[o + 1])
        for node, part in zip(rows.indices[entries], rows.data[entries], strict=True):
            found[o] = [found[o][t] + float(part) * field[int(node), t] for t in range(lags)]
    return flint.arb_mat(found)


def superposed(
    responses: np.ndarray, lag: np.ndarray, told: Controls, at: np.ndarray
) -> np.ndarray:
    """Changes (t, …) that all steps of a case have made at some times, step by step."""
    total = np.zeros((len(at), *responses.shape[2:]), dtype=np.longdouble)
    for source, steps in enumerate(step_sizes(told)):
        for begin, size in steps:
            for t, when in enumerate(at):
                since = when - begin
                if since > 1e-12 * when:
                    total[t] += (
                        np.longdouble(size) * responses[source, np.abs(lag - since).argmin()]
                    )
    return total
