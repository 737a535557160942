"""What each stage hands to the next: named arrays, and nothing else.

Every field is a NumPy array (0-d for a single number or word), so that a product
can be stored, hashed and passed to a kernel as it is. Shapes use n grains, c contacts,
d domains (pores), p pipes, b boundary crossings. Indices are int64, −1 means none. What holds
the state of other rooms (`mechanics.specimen.body.Body`) is made of their named tuples.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple, get_type_hints

import numpy as np

Array = np.ndarray


class Packing(NamedTuple):
    """Grains at rest under the small isotropic packing pressure, in a box larger than the region.

    Forces are given over the normal stiffness, hence in metres: the packing does not
    depend on how stiff the grains are.
    """

    x: Array  # (n,) m
    y: Array  # (n,) m
    radius: Array  # (n,) m
    contact_a: Array  # (c,) first grain of a contact, a < b, sorted by (a, b)
    contact_b: Array  # (c,)
    normal_force: Array  # (c,) m: force / k_n, compression positive, 0 for a lattice at rest
    shear_force: Array  # (c,) m: force / k_n, see mechanics.contacts for the sign
    box: Array  # (4,) m: walls xmin, xmax, ymin, ymax
    porosity: Array  # () of the inner box (without the layer at the walls)
    coordination: Array  # () mean number of contacts of the grains that carry load
    floaters: Array  # () number of grains with fewer than two contacts
    packing_friction: Array  # () friction at which the porosity was reached
    packing_pressure: Array  # () pressure / k_n
    unbalanced_ratio: Array  # () mean unbalanced force over mean contact force
    steps: Array  # () time steps taken
    scale: Array = np.empty(0)  # (n,) size of grains there over the coarse ones; none: all alike


class UnitLoads(NamedTuple):
    """Linear response of the packed, bonded grains to unit stresses, and the factor behind it.

    In units of mean radius and k_n. m = 3 n + 2 unknowns: u_x, u_y and rotation of each grain,
    then the outward displacements of the right and the top wall; see mechanics.stiffness.
    """

    base: Array  # (m,) displacement that balances the packed state
    base_ratio: Array  # () mean unbalanced over mean contact force that it leaves
    packed: Array  # (3,) stresses of the packed state
    displacement: Array  # (3, m) by σ_xx, σ_yy, σ_xy = 1
    shear_strain: Array  # () tilt of the walls by σ_xy = 1
    wall_grain: Array  # (w,) grains at the walls left, right, bottom, top
    wall_start: Array  # (5,) first of each wall
    wall_share: Array  # (w,) part of the wall's shear traction that the grain carries
    contact_a: Array  # (c,) the cemented contacts, a < b, sorted by (a, b), one bond each
    contact_b: Array
    contact_shear: Array  # (c,) shear force of the packed state
    contact_distance: Array  # (c,) of the centres, where the cement was installed
    touching: Array  # (c,) bool: the grains touch, not the cement alone
    loose: Array  # (q,) of the grains at walls, those whose contact may open or close
    loose_touching: Array  # (q,) bool: it is closed in the packed state
    loose_response: Array  # (q, m) float32: displacement by a unit press of the wall on each
    near_a: Array  # (k,) pairs without cement that may come to touch
    near_b: Array
    order: Array  # (m,) of elimination
    start: Array  # (m + 1,) columns of L
    row: Array  # (entries,) int32
    lower: Array  # (entries,)
    pivot: Array  # (m,)


class StressState(NamedTuple):
    """Grains in equilibrium under the walls' stresses."""

    x: Array  # (n,) m
    y: Array  # (n,) m
    contact_a: Array  # (c,) touching or bonded grains, a < b, sorted by (a, b)
    contact_b: Array  # (c,)
    normal_force: Array  # (c,) N per metre of depth, compression positive
    shear_force: Array  # (c,) N per metre of depth
    bonded: Array  # (c,) bool
    joint_gap: Array  # (c,) m: opening of the smooth joint there, NaN where there is none
    crack_x: Array  # (k,) m: where bonds and joint contacts broke, in the order of breaking
    crack_y: Array  # (k,) m
    crack_mode: Array  # (k,) 1 in tension, 2 in shear
    crack_step: Array  # (k,) time step
    crack_strain_xx: Array  # (k,) strain of the box by then, extension positive
    crack_strain_yy: Array  # (k,)
    idle_joints: Array  # () joint traces that no contact crosses
    box: Array  # (4,) m: walls xmin, xmax, ymin, ymax
    stress: Array  # (3,) Pa: xx, yy, xy in the volume, compression positive
    wall_stress: Array  # (4,) Pa on the walls left, right, bottom, top
    unbalanced_ratio: Array  # () mean unbalanced force over mean contact force
    broken_bonds: Array  # ()
    largest_overlap: Array  # () of two grains in contact, over the mean radius
    static: Array  # () 1 where the static solver found the state, 0 the explicit one
    steps: Array  # () time steps taken, or corrections of the static solver
    joint_slip: Array = np.empty(0)  # (c,) m: length of slip of a joint there; none: no joint


class Moduli(NamedTuple):
    """Elastic constants of cemented grains for small strains, in their plane."""

    stiffness: Array  # (3, 3) Pa: stresses xx, yy, xy by strains xx, yy, γ_xy
    youngs_modulus: Array  # () Pa: mean over the directions x and y
    poissons_ratio: Array  # ()


class StrengthTest(NamedTuple):
    """A specimen that was tested to failure; r records along the test."""

    youngs_modulus: Array  # () Pa, secant to half of the peak
    poissons_ratio: Array  # ()
    peak_strength: Array  # () Pa: largest axial stress, in tension positive too
    confining_stress_achieved: Array  # () Pa: mean of the lateral walls up to the peak
    confining_deviation: Array  # () Pa: largest of either from what was wanted, up to the peak
    confinement_held: Array  # () 1 where that is small against the peak strength, else 0
    crack_count: Array  # () bonds and joint contacts broken at the end, k
    cracks_at_peak: Array  # ()
    largest_overlap: Array  # () of two grains in contact at the end, over the mean radius
    axial_stress: Array  # (r,) Pa
    lateral_stress: Array  # (r,) Pa: mean of the lateral walls
    axial_strain: Array  # (r,) in the sense of the test
    lateral_strain: Array  # (r,) opposite to it
    cracks: Array  # (r,) bonds and joint contacts broken
    crack_x: Array  # (k,) m: where they broke, in the order of breaking
    crack_y: Array  # (k,) m
    crack_mode: Array  # (k,) 1 in tension, 2 in shear
    crack_step: Array  # (k,) time step of it, counted as `steps` are
    crack_strain: Array  # (k,) axial strain by then, 0 before the test
    box: Array  # (4,) m: walls xmin, xmax, ymin, ymax before the test
    steps: Array  # () time steps taken
    energy: Array = np.empty(0)  # (7,) J per metre of depth, see ENERGIES; none: not counted


# Parts of the energy of a test: what was put in, how much more is stored, what was lost.
ENERGIES = ("input", "elastic", "kinetic", "slip", "breakage", "damping", "error")


class Network(NamedTuple):
    """Pores and pipes: the faces of the contact graph and the contacts between them.

    Faces are polygons of grain centres, counter-clockwise. Corner k of the ragged arrays
    stands for the edge from `corner_grain[k]` to the next corner of the same face;
    `corner_pipe[k]` is the pipe across that edge, −1 where the other side is outside or
    the same face. Where a pipe between two domains of the region crosses a slot of it, each
    half leads to a domain without corners that lies outside and has no other pipe.
    """

    x: Array  # (d,) centroid, m
    y: Array  # (d,)
    volume: Array  # (d,) pore volume for unit depth, m³ per m
    area: Array  # (d,) area of the polygon, m²
    inside: Array  # (d,) bool: centroid inside the region
    corner_start: Array  # (d + 1,) first corner of each domain
    corner_grain: Array  # (corners,) grain at each corner
    corner_pipe: Array  # (corners,) pipe across the edge that starts there
    pipe_from: Array  # (p,) domain
    pipe_to: Array  # (p,) domain
    pipe_grain_a: Array  # (p,) grains of the contact, a < b
    pipe_grain_b: Array  # (p,)
    pipe_length: Array  # (p,) m: r_a + r_b over their scale; of half a pipe its part
    cut: Array  # (b,) pipes that cross the rim: pipe_from or pipe_to is inside, not both
    cut_inside: Array  # (b,) the domain inside
    cut_outside: Array  # (b,) the domain outside
    cut_side: Array  # (b,) index into region.sides
    cut_fraction: Array  # (b,) part of the segment between centroids that lies inside
    grain_x: Array  # (n,) m
    grain_y: Array  # (n,) m
    grain_radius: Array  # (n,) m
    porosity: Array  # () pore volume over polygon area, domains inside the region
    floaters: Array  # () grains that lie inside domains and carry no edge
    slivers: Array  # () domains whose volume was raised to the floor
    crossing_edges: Array  # () contacts dropped because they crossed another


class Walk(NamedTuple):
    """Where the lines that act on flow run on the network; nothing of how wide they are.

    Traces have m nodes of their own, joined by e branches. Of a pipe, a fraction is counted from
    the centroid of `pipe_from` to that of `pipe_to`.
    """

    line_start: Array  # (lines, 2) m, after clipping to the region
    line_end: Array  # (lines, 2) m
    node_x: Array  # (m,) m
    node_y: Array  # (m,) m
    node_side: Array  # (m, 2) sides of the region where the trace leaves it there, −1 none
    branch_a: Array  # (e,) node; both ends are one where the branch leads to a tip alone
    branch_b: Array  # (e,)
    branch_length: Array  # (e,) m
    branch_line: Array  # (e,)
    cross_pipe: Array  # (c,) pipes that traces cross
    cross_fraction: Array  # (c,)
    cross_node: Array  # (c,)
    cross_line: Array  # (c,)
    wall_pipe: Array  # (q,) pipes that barriers cut
    wall_fraction: Array  # (q,)
    wall_length: Array  # (q,) m of the barrier that meets the pipe
    wall_line: Array  # (q,)
    cut_branch: Array  # (r,) branches that barriers cut
    cut_line: Array  # (r,)
    chain_pipe: Array  # (k,) pipes along fractures of given permeability
    chain_line: Array  # (k,)
    chain_domain: Array  # (h,) pores along them
    chain_domain_line: Array  # (h,)
    chain_storage: Array  # (h,) m of the line that each of these pores stands for


class Apertures(NamedTuple):
    """Open pipes: aperture, conductance and fractures, these as lines of the walk."""

    aperture: Array  # (p,) m
    conductance: Array  # (p,) m³/(s Pa) per metre of depth, Eq. 1; a pipe that is cut as a whole
    volume: Array  # (d,) pore volume after fractures handed theirs over, m³ per m
    on_fracture: Array  # (p,) index of the line that a pipe runs along, −1 in the matrix
    cut_conductance: Array  # (b,) between the domain inside and the rim, m³/(s Pa)
    trace_start: Array  # (lines, 2) m, after clipping to the region
    trace_end: Array  # (lines, 2) m
    trace_fracture: Array  # (lines,) index of the fracture in the scene
    trace_pipes: Array  # (lines,) number of pipes that it crosses or runs along
    trace_acts: Array  # (lines,) number of pipes and branches that it changed
    node_x: Array  # (m,) m: nodes of the traces
    node_y: Array  # (m,) m
    node_side: Array  # (m, 2) sides of the region where the trace leaves it there, −1 none
    node_volume: Array  # (m,) m³ per m: aperture times length
    branch_a: Array  # (e,) node
    branch_b: Array  # (e,) node
    branch_line: Array  # (e,)
    branch_length: Array  # (e,) m
    branch_aperture: Array  # (e,) m, hydraulic
    branch_conductance: Array  # (e,) T / Δs with T = w³ / (12 μ), m³/(s Pa)
    cross_pipe: Array  # (c,) pipes that traces and barriers cut, sorted by pipe and fraction
    cross_fraction: Array  # (c,) from the centroid of pipe_from to that of pipe_to
    cross_node: Array  # (c,) node of the trace, −1 at a barrier
    cross_resistance: Array  # (c,) Pa s/m³ of the barrier, 0 at a trace
    matrix_aperture: Array  # () w0, m


class Responses(NamedTuple):
    """Pressure changes for unit steps of each source: rates and fixed pressures.

    o counts the recorded quantities, in the order `flow.records.Records` states; lags are
    times since a step. A steady study has one lag, infinity.
    """

    lag: Array  # (l,) s
    output: Array  # (sources, l, o) per unit of the source
    cumulative: Array  # (sources, l, k) time integrals of boundary inflow and storage, per unit
    pressure: Array  # (sources, l, m) maps on the domains inside, m = 0 where none is asked for
    missing: Array  # (sources, l) m³ out of balance before that was mended (steady: m³/s)
    least_flow: Array  # (sources,) m³/s by a fixed pressure that would fill all pores in time
    domain: Array  # (m,) the domains of the maps
    reached: Array  # (m,) bool: some source reaches the domain
    time_error: Array  # () estimated relative error in time
    tolerance_met: Array  # () 1 where it is within the tolerance, else 0; NaN without an estimate
    residual: Array  # () relative residual of the solve
    work: Array  # () steps or solves
    probe_reached: Array  # (probes,) bool: some source reaches the probe's domain
    probe_place: Array  # (probes, 2) m: the place whose pressure is recorded
    isolated: Array  # () domains that no source reaches; they keep the initial pressure
    # the same of unit initial fields; l = 1 where they stay as they are
    initial_output: Array  # (fields, l, o)
    initial_cumulative: Array  # (fields, l, k)
    initial_pressure: Array  # (fields, l, m)
    initial_volume: Array  # (fields,) m³ that lie on the wrong side of the mean, per unit
    initial_missing: Array  # (fields, l)
    solver: Array  # () word: the solver that ran
    solver_reason: Array  # () words: why it was taken


class Emulator(NamedTuple):
    """A small model of flow equations that differ in how wide their fractures are.

    t terms (the rock, then f classes of branches), q vectors, o outputs, r radii of a contour, k
    samples, m references, c snapshots. See `flow.solvers.emulator`.
    """

    usable: Array  # () 1, or 0 where the family has none
    reason: Array  # () words: why not
    branch_class: Array  # (e,) 1 … f, or 0 of branches that are alike in all cases
    branch_aperture: Array  # (e,) m, of which shares are counted
    wells: Array  # () the first vectors, which are wells without storage
    conductance: Array  # (t, q, q)
    storage: Array  # (t, q, q)
    stored: Array  # (t, q)
    sealed: Array  # () 1 where nothing keeps its pressure, so that the constants never decay
    highest: Array  # (q,) Pa: the largest pressure of each vector
    ports: Array  # (t, q, o)
    direct: Array  # (t, sources, o)
    counted: Array  # (o,) bool: held to the tolerance
    reference_conductance: Array  # (m, t) shares
    reference_storage: Array  # (m, t)
    seen_conductance: Array  # (m, t, r, k, q)
    seen_storage: Array  # (m, t, r, k, q)
    seen_ports: Array  # (m, t, r, k, o)
    snapshot_conductance: Array  # (c, t) shares
    snapshot_storage: Array  # (c, t)
    poles: Array  # (c, p) 1/s at which they were taken, filled up with zeros
    snapshots: Array  # () different members among them
    largest_error: Array  # () bound for the members that it was made of


class Permeability(NamedTuple):
    """Permeability tensor of the region; of the *calibrate* stage, at an aperture of 1 m."""

    tensor: Array  # (2, 2) m²


class BarPermeability(NamedTuple):
    """Permeability of the region as a bar with sealed sides."""

    along: Array  # (2,) m², along x and y


class PeriodicPermeability(NamedTuple):
    """Permeability of the region where it repeats itself endlessly."""

    tensor: Array  # (2, 2) m²


class FractureNetwork(NamedTuple):
    """What the network of the conducting traces is, by its geometry; ports are sides and wells."""

    nodes_i: Array  # () free ends
    nodes_y: Array  # () ends on another trace
    nodes_x: Array  # () crossings
    nodes_rim: Array  # () ends at the rim
    traces: Array  # ()
    branches: Array  # () between nodes
    connections: Array  # () per line
    clusters: Array  # () traces that hang together
    p20: Array  # () 1/m²
    p21: Array  # () 1/m
    p22: Array  # ()
    backbone: Array  # () part of the length on a way between two ports
    joined_pairs: Array  # () pairs of sides and wells that traces alone join
    well_joined: Array  # (wells,) other ports that each is joined to
    side_joined: Array  # (sides of fixed pressure,)
    conductance: Array  # (ports, ports) m³/(s Pa) into each by unit pressure at each, rock sealed
    oda: Array  # (2, 2) m²
    snow: Array  # (2, 2) m²


def named(product: Any) -> dict[str, Any]:
    """Return the arrays of a product by their names.

    Those of a named tuple in it stand under its name and theirs, `grains.x`.
    """
    if isinstance(product, Mapping):
        return dict(product)
    found: dict[str, Any] = {}
    for name, value in product._asdict().items():
        if hasattr(value, "_asdict"):
            found |= {f"{name}.{inner}": array for inner, array in named(value).items()}
        else:
            found[name] = value
    return found


def build(kind: Any, arrays: Mapping[str, Array]) -> Any:
    """Return a product from its arrays, as `named` gives them: a dict or a named tuple.

    Fields that are declared as plain numbers become such.
    """
    if issubclass(kind, dict):
        return dict(arrays)
    fields: dict[str, Any] = {}
    for name, own in _fields(kind).items():
        if hasattr(own, "_fields"):
            start = f"{name}."
            inner = {k.removeprefix(start): a for k, a in arrays.items() if k.startswith(start)}
            fields[name] = build(own, inner)
        else:
            fields[name] = own(arrays[name].item()) if own in (int, float) else arrays[name]
    return kind(**fields)


@cache
def _fields(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind)
