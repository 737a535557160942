"""A linear poroelastic rock: K u = A p + f, C dp/dt + Aᵀ du/dt = −G p + q.

u are the displacements of grains and walls, p the pressures of pores, wells and nodes of traces,
A = dV/dx (`duality`), K the stiffness of the frame, C the fluid's storage, G the conductances.
Eliminating u leaves B dp/dt = −G p + q − AᵀK⁻¹ df/dt with B = C + AᵀK⁻¹A, symmetric and positive
definite. B is full and never formed: (G + s B) p = b is solved with u beside p,

    [ K    −A       ] [u]   [   0  ]
    [ −Aᵀ  −(C+G/s) ] [p] = [ −b/s ],

one sparse factor for each s; s = ∞ gives the undrained response B p = b.

Inside, lengths count over the mean radius and pressures over k_n; K, C and A are then of one size.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.sparse import block_array, coo_array, csc_array, csr_array, diags_array

from demflow.model.coupling.duality import place_of, pores_of, volume_gradient
from demflow.model.coupling.frame import Frame
from demflow.model.flow.equation.system import System
from demflow.model.mechanics.static.stiffness import Quasidefinite
from demflow.model.products import Network, Packing

Array = np.ndarray

# Of the mean storage: what stores nothing, a well, is given so much, which it fills or empties a
# million times faster than a pore does.
LEAST_STORAGE = 1e-6


class Source(NamedTuple):
    """What a unit of a source puts on a rock from time zero on, in its units."""

    force: Array  # (m,) f, at once
    flow: Array  # (n,) q, 1/s


class Rock(NamedTuple):
    """m displacements and n pressures, in units of mean radius, k_n and seconds."""

    frame: Frame
    system: System
    modulus: float  # k_n, Pa
    squeeze: csr_array  # (m, n) A
    held: csr_array  # (m, fixed) A of the pores that each fixed pressure holds
    storage: Array  # (n,) C
    conductance: csc_array  # (n, n) G

    @property
    def size(self) -> float:
        """m² by which volumes for unit depth are counted."""
        return self.frame.unit**2

    def factor(self, shift: float) -> Quasidefinite:
        """Factor for (G + s B) p = b at a shift s in 1/s, infinity for B p = b."""
        pressed = diags_array(self.storage) + self.conductance / shift
        return Quasidefinite(self._joint(pressed))

    def update(self, factor: Quasidefinite, shift: float) -> None:
        """Make a factor that of another shift."""
        factor.update(self._joint(diags_array(self.storage) + self.conductance / shift))

    def solve(self, factor: Quasidefinite, shift: float, load: Array) -> Array:
        """The pressures (n,) of (G + s B) p = b.

        Parameters
        ----------
        factor : factor of the matrix
        shift : over the time step, 1/s
        load : right-hand side
        """
        return self.solve_both(factor, shift, load)[0]

    def solve_both(self, factor: Quasidefinite, shift: float, load: Array) -> tuple[Array, Array]:
        """The pressures (n,) of (G + s B) p = b, and their u = K⁻¹ A p (m,).

        Parameters
        ----------
        factor : factor of the matrix
        shift : over the time step, 1/s
        load : right-hand side
        """
        m = len(self.frame.free)
        right = np.zeros(m + self.system.n)
        right[m:] = -load if math.isinf(shift) else -load / shift
        found = factor.solve(right)
        return found[m:], found[:m]

    def stored(self, pressure: Array, moved: Array) -> Array:
        """B p = C p + Aᵀ u, (n,), where u = K⁻¹ A p."""
        return np.asarray(self.storage * pressure + self.squeeze.T @ moved)

    def unit_pressure(self, index: int) -> Source:
        """A fixed pressure that rises by 1 Pa: it flows in, and pushes its own pores open."""
        force = self.held[:, [index]].toarray()[:, 0] / self.modulus
        return Source(force, self.system.source(index) / self.size)

    def unit_rate(self, index: int) -> Source:
        """1 m³/s that a well at a rate, or a unit field, moves, by its number among sources."""
        return Source(np.zeros(len(self.frame.free)), self.system.source(index) / self.size)

    def unit_load(self, wall: str, length: float) -> Source:
        """1 Pa more on a wall of a length in m; nothing where it stands."""
        force = np.zeros(len(self.frame.free))
        if (at := self.frame.wall(wall)) >= 0:
            force[at] = -length / self.frame.unit / self.modulus
        return Source(force, np.zeros(self.system.n))

    def jump(self, source: Source) -> Array:
        """B p right after a source acted, (n,): −AᵀK⁻¹ f."""
        if not source.force.any():
            return np.zeros(self.system.n)
        return np.asarray(-(self.squeeze.T @ self.frame.moved(source.force)))

    def _joint(self, pressed: csc_array) -> csc_array:
        return csc_array(
            block_array(
                [[self.frame.stiffness, -self.squeeze], [-self.squeeze.T, -csc_array(pressed)]]
            )
        )


def rock_of(
    packing: Packing, network: Network, frame: Frame, system: System, modulus: float
) -> Rock:
    """The rock of a frame (of the packing) and a flow equation (on its `network` between walls).

    Parameters
    ----------
    packing : grains at rest under the packing pressure
    network : pores and pipes of the matrix
    frame : stiffness of the grains
    system : the flow equation C dp/dt = −G p + f
    modulus : of the fluid, Pa
    """
    pores = pores_of(packing, network)
    gradient = volume_gradient(pores, place_of(packing.x, packing.y, packing.box)).tocsr()
    gradient = csr_array(gradient[frame.free] / frame.unit)
    pore = np.arange(len(network.x))
    node, source = system.node_of_domain[pore], system.source_of_domain[pore]
    scale = modulus / frame.unit**2
    return Rock(
        frame=frame,
        system=system,
        modulus=modulus,
        squeeze=csr_array(gradient @ _joins(node, system.n)),
        held=csr_array(gradient @ _joins(source, system.fixed_count)),
        storage=np.maximum(system.storage, LEAST_STORAGE * system.storage.mean()) * scale,
        conductance=conductances(system, scale),
    )


def conductances(system: System, scale: float) -> csc_array:
    """G (n, n) of a flow equation, times a scale."""
    i, j, g = system.edge_i, system.edge_j, system.edge_g * scale
    diagonal = np.bincount(i, g, system.n) + np.bincount(j, g, system.n) + system.excess * scale
    whole = np.arange(system.n)
    entries = (np.concatenate([-g, -g, diagonal]), (np.r_[i, j, whole], np.r_[j, i, whole]))
    return coo_array(entries, shape=(system.n, system.n)).tocsc()


def _joins(column: Array, count: int) -> csr_array:
    """Matrix that adds up what belongs to one column; −1 belongs to none."""
    (row,) = np.nonzero(column >= 0)
    shape = (len(column), count)
    return coo_array((np.ones(len(row)), (row, column[row])), shape=shape).tocsr()
