"""One table of everything that a result can hold: its name, unit, dimensions and meaning.

Dataset attributes, axis labels and documentation read it; nothing else repeats it.
Dimensions are named as in the dataset; the axes of a study come before them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from demflow.model.outcome import ModelError
from demflow.model.scene import MEASURED_BY_A_TEST
from demflow.model.transient import SMOOTHING


class Quantity(NamedTuple):
    """A named result."""

    unit: str  # as UDUNITS and CF write it
    dimensions: tuple[str, ...]
    long_name: str
    needs: tuple[str, ...] = ()  # recorded where one of these is observed; empty: always
    transient: bool = False  # has a meaning in time only, not in a steady study
    constants: tuple[tuple[str, float], ...] = ()  # further attributes
    gaps: bool = False  # may be NaN in places where the case is good
    text: bool = False  # words, not numbers
    comment: str = ""  # how it is found, where that is not plain
    standard_name: str = ""  # of CF


SUPERPOSED = (
    "superposed: one response to a unit step of each well and side, scaled by every change of "
    "rate or pressure and shifted to its time; cases that differ in these alone share it"
)

STOPPED = "stopped"  # of a case that has it and no empty word there; the dataset's `message`

FAILURE = "failure"  # of a member of a family that has it, and no empty word: why it has no result

_NETWORK = ("fracture_network",)
_BREAKING = ("crack_length", "injected_volume", "joint_slip")


# Variables of the dataset, one value or array per case.
CASE: dict[str, Quantity] = {
    "well_pressure": Quantity(
        "Pa",
        ("well", "elapsed_time"),
        "bottom-hole pressure",
        ("well_pressure",),
        comment=SUPERPOSED,
    ),
    "well_rate": Quantity(
        "m3 s-1",
        ("well", "elapsed_time"),
        "well rate for unit depth, positive for production",
        ("well_pressure",),
    ),
    "well_limited": Quantity(
        "1",
        ("well", "elapsed_time"),
        "1 where a limit of pressure decides the well's rate, else 0",
        comment="of wells with a least or a largest pressure",
    ),
    "pressure_change": Quantity(
        "Pa",
        ("well", "elapsed_time"),
        "pressure change since the last rate change, positive in the sense of the change",
        ("well_pressure",),
        transient=True,
        gaps=True,
        comment="of a well that never flows, since the last change of the others' rates in sum",
    ),
    "pressure_derivative": Quantity(
        "Pa",
        ("well", "elapsed_time"),
        "Bourdet derivative of the pressure change by the logarithm of time since the rate change",
        ("well_pressure",),
        transient=True,
        constants=(("smoothing_window", SMOOTHING),),
        gaps=True,
        comment="of a shut-in by the logarithm of the equivalent time of Agarwal, in which every "
        "change of rate before it counts; by the time itself where rates of both signs came before",
    ),
    "permeability": Quantity(
        "m2",
        ("row", "column"),
        "permeability tensor of the region",
        ("permeability",),
        comment="with a pressure linear along the rim: an upper bound where fractures meet it; "
        "under `coupling: breaking` that of apertures without stress, permeability_in_time is that "
        "of the loaded rock",
    ),
    "bar_permeability": Quantity(
        "m2",
        ("direction",),
        "permeability of the region as a bar with sealed sides along the flow",
        ("bar_permeability",),
        comment="flow between the two sides across times viscosity and length, over their area and "
        "fall of pressure",
    ),
    "periodic_permeability": Quantity(
        "m2",
        ("row", "column"),
        "permeability tensor of endless copies of the region side by side",
        ("periodic_permeability",),
        comment="each place where something leaves is joined to the nearest on the opposite side; "
        "never above permeability",
    ),
    "boundary_flow": Quantity(
        "m3 s-1",
        ("boundary", "elapsed_time"),
        "flow through the boundary for unit depth, positive into the region",
        ("boundary_flow",),
        comment=SUPERPOSED,
    ),
    "boundary_pressure": Quantity(
        "Pa",
        ("boundary", "elapsed_time"),
        "pressure along the boundary",
        ("boundary_pressure",),
        comment=SUPERPOSED,
    ),
    "probe_pressure": Quantity(
        "Pa",
        ("probe", "elapsed_time"),
        "pressure at the probe, linear between the pores around",
        ("probe_pressure",),
        gaps=True,
        comment=SUPERPOSED,
    ),
    "wall_displacement": Quantity(
        "m",
        ("wall", "elapsed_time"),
        "way of the wall since the start, outwards",
        ("wall_displacement",),
        transient=True,
        comment="minus that of the top wall is the settlement; " + SUPERPOSED,
    ),
    "effective_stress": Quantity(
        "Pa",
        ("component", "elapsed_time"),
        "mean effective stress of the specimen, compression positive",
        ("effective_stress",),
        transient=True,
        comment="what contacts bear: forces times branches over the area; where the scene names no "
        "stress, its change since the start",
    ),
    "kept_conductance": Quantity(
        "1",
        ("elapsed_time",),
        "sum of the conductances of all pipes over that at the start",
        ("wall_displacement", "effective_stress"),
        transient=True,
        comment="where apertures follow the forces on them while fluid moves",
    ),
    "coupling_used": Quantity("", (), "how fluid and rock were coupled", text=True),
    "coupling_reason": Quantity(
        "", (), "how much apertures that follow forces were expected to change", text=True
    ),
    "lowest_pressure": Quantity(
        "Pa", (), "lowest pressure of wells, probes and sides at the recorded times"
    ),
    "negative_pressure": Quantity(
        "1",
        (),
        "1 where the lowest pressure is below zero, else 0",
        comment="no liquid bears that, if pressures are absolute",
    ),
    "pores_per_well": Quantity(
        "1",
        ("well",),
        "diameter of the well over the spacing of the pores around it",
        ("well_pressure",),
        comment="below some five, what is close to the well is coarser than the well itself",
    ),
    "probe_place_x": Quantity(
        "m", ("probe",), "x of the place whose pressure the probe has", ("probe_pressure",)
    ),
    "probe_place_y": Quantity(
        "m", ("probe",), "y of the place whose pressure the probe has", ("probe_pressure",)
    ),
    "porosity": Quantity("1", (), "pore volume over polygon area of the domains in the region"),
    "matrix_aperture": Quantity("m", (), "unstressed pipe aperture of the matrix, w0"),
    "coordination": Quantity("1", (), "mean number of contacts of the grains that carry load"),
    "fabric": Quantity("1", ("row", "column"), "fabric tensor of the packing, mean of n ⊗ n"),
    "fabric_anisotropy": Quantity(
        "1", (), "difference of the principal values of the packing's fabric over their sum"
    ),
    "floater_fraction": Quantity("1", (), "part of all grains of the packing that bear no load"),
    "largest_overlap": Quantity("1", (), "largest overlap in the packing over the mean radius"),
    "loaded_overlap": Quantity(
        "1",
        (),
        "largest overlap of two grains under stress, or at the end of a test, over the mean radius",
        comment="beyond 0.1 a case is not called good, beyond 0.5 it fails",
    ),
    "packing_friction": Quantity("1", (), "friction at which the grains were packed"),
    "packing_pressure": Quantity(
        "1", (), "isotropic stress at which the grains were packed over the normal stiffness"
    ),
    "grain_count": Quantity("1", (), "grains whose centre lies inside the region"),
    "domain_count": Quantity("1", (), "pores inside the region"),
    "floaters": Quantity("1", (), "grains without load in the packing, treated as solid in pores"),
    "slivers": Quantity("1", (), "pores whose volume was raised to the floor"),
    "smallest_pore": Quantity(
        "1", (), "volume of the smallest pore over the mean, as fractures leave them"
    ),
    "idle_traces": Quantity("1", (), "fracture traces that changed no pipe"),
    "parted_pipes": Quantity("1", (), "pipes whose grains parted under the stress"),
    "isolated_domains": Quantity("1", (), "pores that no well and no boundary reaches"),
    "mass_balance_error": Quantity(
        "1", (), "largest imbalance of stored, injected and boundary volume over the volume moved"
    ),
    "mass_imbalance": Quantity(
        "1",
        (),
        "the same before the solver put its balance right, relative to the volume moved",
        comment="krylov and implicit solve for pressures to a tolerance and then see to it that "
        "the volume balances to round-off; this is what was missing, all of it of one sign",
    ),
    "flow_balance_error": Quantity(
        "1",
        (),
        "largest part of the volume moved that the recorded flows do not explain",
        comment="of unit responses, whose flows rise or fall all the time: what is stored from one "
        "time to the next must lie between what the flows at both let in",
    ),
    "residual": Quantity(
        "1",
        (),
        "residual of the flow equation at the last time, relative",
        comment="before any repair of the balance; steady: the largest imbalance of a pore over "
        "the flow through it; transient: the correction of pressure that balances every pore, "
        "over the largest pressure",
    ),
    "range_error": Quantity(
        "1",
        (),
        "largest excursion of unit responses from what the maximum principle allows, relative",
        comment="a fixed pressure leaves all pressures between the old and its own, a well's "
        "production raises none; no fixed pressure takes in against its sense",
    ),
    "estimated_error": Quantity(
        "1",
        (),
        "relative error in time as the solver estimates it; explicit makes no estimate",
        gaps=True,
    ),
    "tolerance_met": Quantity(
        "1",
        (),
        "1 where the estimated error is within solver.tolerance, 0 where round-off hides it",
        gaps=True,
        comment="no value where the solver makes no estimate",
    ),
    "time_error": Quantity(
        "1",
        (),
        "relative error in time against the exact solution of the same network",
        ("time_error",),
        transient=True,
        gaps=True,
    ),
    "reference_error": Quantity(
        "1",
        (),
        "estimated relative error of what time_error takes for the exact solution",
        ("time_error",),
        transient=True,
        gaps=True,
    ),
    "solver_used": Quantity("", (), "flow solver that ran", text=True),
    "emulator_snapshots": Quantity(
        "1",
        (),
        "cases of the family that the small model was made of which answers this one",
        gaps=True,
        comment="where solver_used is emulated; estimated_error is a bound there",
    ),
    "solver_reason": Quantity("", (), "why that flow solver was taken", text=True),
    "stress_achieved": Quantity(
        "Pa", ("component",), "stress in the specimen, positive in compression"
    ),
    "unbalanced_ratio": Quantity("1", (), "mean unbalanced force over mean contact force"),
    "youngs_modulus": Quantity(
        "Pa", (), "Young's modulus, secant to half of the peak stress", ("youngs_modulus",)
    ),
    "poissons_ratio": Quantity("1", (), "Poisson's ratio, in the plane", ("poissons_ratio",)),
    "elastic_youngs_modulus": Quantity(
        "Pa",
        (),
        "Young's modulus for small strains, mean over the directions x and y",
        ("elastic_moduli",),
        comment="of the slice as it lies, between its joints: cemented contacts of the packed "
        "state, none of which slips or breaks",
    ),
    "elastic_poissons_ratio": Quantity(
        "1", (), "Poisson's ratio for small strains, in the plane", ("elastic_moduli",)
    ),
    "rock_youngs_modulus": Quantity(
        "Pa",
        (),
        "Young's modulus of the rock whose slice in plane strain shows these moduli",
        ("elastic_moduli",),
    ),
    "rock_poissons_ratio": Quantity(
        "1",
        (),
        "Poisson's ratio of the rock whose slice in plane strain shows these moduli",
        ("elastic_moduli",),
    ),
    "force_chains": Quantity(
        "1",
        (),
        "strings of three and more grains that are pressed more than the mean along their contacts",
        ("force_chains",),
        comment="Peters et al. 2005, Phys. Rev. E 72, 041307, within 45 degrees",
    ),
    "chained_force_share": Quantity(
        "1",
        (),
        "share of the sum of contact forces that force chains carry",
        ("force_chains",),
    ),
    "region_stress": Quantity(
        "Pa",
        ("component",),
        "mean stress of the contacts within the region, positive in compression",
        ("force_chains",),
    ),
    "peak_strength": Quantity(
        "Pa", (), "largest axial stress of the test to failure", ("peak_strength",)
    ),
    "confining_stress_achieved": Quantity(
        "Pa", (), "mean stress on the lateral walls of the test up to the peak", MEASURED_BY_A_TEST
    ),
    "confining_deviation": Quantity(
        "Pa",
        (),
        "largest deviation of a lateral wall from the confining stress up to it",
        MEASURED_BY_A_TEST,
    ),
    "confinement_held": Quantity(
        "1",
        (),
        "1 where the confining stress was held within 1 % of the peak strength, else 0",
        MEASURED_BY_A_TEST,
        comment="where it is 0, a lower test.strain_step holds it better",
    ),
    "crack_count": Quantity(
        "1", (), "bonds and joint contacts broken at the end of the test", ("crack_count",)
    ),
    "energy": Quantity(
        "J m-1",
        ("energy_part",),
        "energy of the test for unit depth, from the confining stress to its end",
        ("energy",),
        comment="input = elastic + kinetic + slip + breakage + damping + error; elastic and "
        "kinetic are what was stored more than at the start",
    ),
    "broken_bonds": Quantity("1", (), "bonds that broke under the stress"),
    "static_solver": Quantity("1", (), "1 where the static solver found the stress state, else 0"),
    "mechanical_steps": Quantity(
        "1", (), "time steps to the stress state, or corrections of the static solver"
    ),
    "tension_cracks": Quantity("1", (), "bonds and joint contacts that broke in tension"),
    "shear_cracks": Quantity("1", (), "bonds and joint contacts that broke in shear"),
    "joint_contacts": Quantity("1", (), "contacts across smooth joints"),
    "idle_joints": Quantity("1", (), "joint traces that no contact crosses"),
    "event_time": Quantity("s", ("event",), "time of the event"),
    "event_x": Quantity("m", ("event",), "x of the bond or joint contact"),
    "event_y": Quantity("m", ("event",), "y of the bond or joint contact"),
    "event_mode": Quantity(
        "1",
        ("event",),
        "1 broken in tension, 2 in shear, 3 a contact of a joint began to slide",
    ),
    "event_pore": Quantity(
        "1", ("event",), "domain beside it of the higher pressure, -1 where no pipe runs there"
    ),
    "event_energy": Quantity("J m-1", ("event",), "energy that the event set free"),
    "crack_length": Quantity(
        "m",
        ("elapsed_time",),
        "length of what broke, from pore to pore through each broken contact",
        ("crack_length",),
    ),
    "joint_slip": Quantity(
        "m",
        ("elapsed_time",),
        "mean slip of the joints since the start, over their length",
        ("joint_slip",),
        comment="length of the way that contacts slid, to and fro; elastic shear is none",
    ),
    "largest_joint_slip": Quantity(
        "m", ("elapsed_time",), "largest slip of a contact of the joints", ("joint_slip",)
    ),
    "slid_joint_share": Quantity(
        "1",
        ("elapsed_time",),
        "part of the joints' length that slid, as the rock was loaded too",
        ("joint_slip",),
    ),
    "slide_events": Quantity(
        "1",
        (),
        "contacts of joints that began to slide, as the rock was loaded too",
        ("joint_slip",),
    ),
    "permeability_in_time": Quantity(
        "m2",
        ("elapsed_time", "row", "column"),
        "permeability tensor of the rock with its joints and cracks as they stand",
        ("permeability_in_time",),
        comment="with a pressure linear along the rim of a part off the walls",
    ),
    "permeability_at_start": Quantity(
        "m2",
        ("row", "column"),
        "the same of the loaded rock at time zero",
        ("permeability_in_time",),
    ),
    "highest_well_pressure": Quantity(
        "Pa", ("well",), "highest pressure of the well after any step of a march through breaks"
    ),
    "injected_volume": Quantity(
        "m3", ("elapsed_time",), "volume that the wells gave for unit depth", ("injected_volume",)
    ),
    "leaked_volume": Quantity(
        "m3",
        ("elapsed_time",),
        "part of the injected volume that is in no well and beside no broken contact",
        ("injected_volume",),
    ),
    "work_put_in": Quantity(
        "J m-1", (), "work of wells, sides and walls, from time zero to the last time", _BREAKING
    ),
    "viscous_loss": Quantity("J m-1", (), "part of it that friction in the fluid took", _BREAKING),
    "slip_loss": Quantity("J m-1", (), "part of it that sliding contacts took", _BREAKING),
    "energy_set_free": Quantity("J m-1", (), "energy that breaks set free meanwhile", _BREAKING),
    "energy_imbalance": Quantity(
        "1",
        (),
        "what the books of energy lack, step by step and without signs, over the work put in",
        _BREAKING,
    ),
    "energy_jerks": Quantity(
        "1",
        (),
        "work that the trapezoidal rule misses where contacts open or close within a step, over "
        "the work put in",
        _BREAKING,
    ),
    "loose_grains": Quantity(
        "1", (), "grains that came free and are held where they were", _BREAKING
    ),
    "breaking_factorisations": Quantity("1", (), "matrices that were factored", _BREAKING),
    "breaking_solves": Quantity("1", (), "solves with these factors", _BREAKING),
    STOPPED: Quantity("", (), "why the case stopped early; what came before is kept", text=True),
    "network_nodes_i": Quantity("1", (), "free ends of traces inside the region", _NETWORK),
    "network_nodes_y": Quantity("1", (), "ends of traces on another trace", _NETWORK),
    "network_nodes_x": Quantity("1", (), "crossings of traces", _NETWORK),
    "network_nodes_rim": Quantity("1", (), "ends of traces at the rim of the region", _NETWORK),
    "network_traces": Quantity("1", (), "traces in the region that conduct", _NETWORK),
    "network_branches": Quantity("1", (), "pieces of traces between nodes", _NETWORK),
    "network_clusters": Quantity("1", (), "groups of traces that hang together", _NETWORK),
    "network_p20": Quantity("m-2", (), "traces per area", _NETWORK),
    "network_p21": Quantity("m-1", (), "length of traces per area", _NETWORK),
    "network_p22": Quantity("1", (), "length of traces per area times their mean", _NETWORK),
    "network_backbone": Quantity(
        "1", (), "part of the traces' length on a way between two sides or wells", _NETWORK
    ),
    "connections_per_line": Quantity("1", (), "4 (Y + X) / (I + Y)", _NETWORK),
    "joined_pairs": Quantity("1", (), "pairs of sides and wells that traces alone join", _NETWORK),
    "well_joined": Quantity(
        "1", ("well",), "sides and other wells that traces alone join to the well", _NETWORK
    ),
    "boundary_joined": Quantity(
        "1", ("boundary",), "other sides and wells that traces alone join to it", _NETWORK
    ),
    "fracture_flow_share": Quantity(
        "1",
        (),
        "flow that fractures would carry alone over the inflow, at the last time",
        _NETWORK,
        gaps=True,
        comment="at the pressures found, of fractures given by an aperture, the rock sealed; no "
        "value where no pressures are computed",
    ),
    "oda_permeability": Quantity(
        "m2",
        ("row", "column"),
        "Oda's tensor of the fractures by their apertures, without the rock",
        _NETWORK,
    ),
    "snow_permeability": Quantity(
        "m2",
        ("row", "column"),
        "Snow's tensor of the fractures, each extended through the region, without the rock",
        _NETWORK,
    ),
}

# Dimensions along which each case has a number of values of its own, and that number.
RAGGED: dict[str, Quantity] = {
    "event": Quantity(
        "1",
        (),
        "number of events of the case",
        comment="events stand one case after the other, the last axis of the study fastest",
    ),
}

# What the sweep makes of the permeability of each case.
PRINCIPAL: dict[str, Quantity] = {
    "permeability_largest": Quantity(
        "m2", (), "largest principal permeability", ("permeability",), gaps=True
    ),
    "permeability_smallest": Quantity(
        "m2", (), "smallest principal permeability", ("permeability",), gaps=True
    ),
    "permeability_direction": Quantity(
        "degree",
        (),
        "direction of the largest permeability from the x axis, counter-clockwise",
        ("permeability",),
        gaps=True,
    ),
    "permeability_anisotropy": Quantity(
        "1", (), "largest over smallest principal permeability", ("permeability",), gaps=True
    ),
}

# Variables of an ensemble: along all axes but that of the seed, over the cases that are good.
ENSEMBLE: dict[str, Quantity] = {
    "permeability_mean": Quantity(
        "m2", ("row", "column"), "mean permeability of the ensemble", ("permeability",)
    ),
    "permeability_error": Quantity(
        "m2",
        ("row", "column"),
        "standard error of that mean: the spread over the root of the number of members",
        ("permeability",),
        comment="no value of fewer than two members",
    ),
    "ensemble_members": Quantity(
        "1", (), "members of the ensemble that have a permeability", ("permeability",)
    ),
}

# Variables that the sweep adds to each case.
SWEEP: dict[str, Quantity] = {
    "compute_time": Quantity("s", (), "time spent in the stages that this case caused to run"),
    "stage_time": Quantity("s", ("stage",), "time of the stage run, shared or not"),
    "solver_time": Quantity(
        "s", (), "processor time of the flow solver, which equal cases share", ("time_error",)
    ),
}

# Coordinates of the dataset that are not axes of a study.
COORDINATES: dict[str, Quantity] = {
    "elapsed_time": Quantity("s", ("elapsed_time",), "time since the start"),
    "well": Quantity("", ("well",), "well"),
    "boundary": Quantity("", ("boundary",), "side of the region with a pressure or an inflow"),
    "probe": Quantity("", ("probe",), "probe"),
    "probe_x": Quantity("m", ("probe",), "x of the probe"),
    "probe_y": Quantity("m", ("probe",), "y of the probe"),
    "row": Quantity("", ("row",), "row of a tensor"),
    "column": Quantity("", ("column",), "column of a tensor"),
    "component": Quantity("", ("component",), "component of the stress"),
    "direction": Quantity("", ("direction",), "direction of the flow"),
    "energy_part": Quantity("", ("energy_part",), "part of the energy of a test"),
    "wall": Quantity("", ("wall",), "wall of the specimen"),
    "stage": Quantity("", ("stage",), "stage of a case"),
}

X_NAME, Y_NAME = "projection_x_coordinate", "projection_y_coordinate"  # of CF: metres, a plane

# Variables of one case's maps.
MAPS: dict[str, Quantity] = {
    "x": Quantity("m", ("domain",), "x of the centroid of the domain", standard_name=X_NAME),
    "y": Quantity("m", ("domain",), "y of the centroid of the domain", standard_name=Y_NAME),
    "volume": Quantity("m3", ("domain",), "pore volume for unit depth"),
    "pressure": Quantity(
        "Pa",
        ("elapsed_time", "domain"),
        "pore pressure",
        ("pressure_map",),
        comment=SUPERPOSED,
    ),
    "aperture": Quantity("m", ("pipe",), "aperture of the pipe"),
    "conductance": Quantity("m3 s-1 Pa-1", ("pipe",), "conductance of the pipe for unit depth"),
    "from_domain": Quantity("1", ("pipe",), "domain at one end of the pipe"),
    "to_domain": Quantity("1", ("pipe",), "domain at the other end, -1 outside"),
    "on_fracture": Quantity(
        "1",
        ("pipe",),
        "index of the fracture the pipe runs along, -1 none",
        comment="branches of traces with an aperture are the last pipes, between the domains in "
        "which their ends lie",
    ),
    "pipe_x": Quantity("m", ("pipe",), "x of the narrowest place", standard_name=X_NAME),
    "pipe_y": Quantity("m", ("pipe",), "y of the narrowest place", standard_name=Y_NAME),
    "well": Quantity("", ("well",), "well", text=True),
    "well_x": Quantity("m", ("well",), "x of the well", standard_name=X_NAME),
    "well_y": Quantity("m", ("well",), "y of the well", standard_name=Y_NAME),
    "well_radius": Quantity("m", ("well",), "radius of the well"),
    "fracture": Quantity("", ("fracture",), "fracture", text=True),
    "trace_from_x": Quantity("m", ("trace",), "x of the begin of a trace as it was meant"),
    "trace_from_y": Quantity("m", ("trace",), "y of the begin of a trace as it was meant"),
    "trace_to_x": Quantity("m", ("trace",), "x of the end of a trace as it was meant"),
    "trace_to_y": Quantity("m", ("trace",), "y of the end of a trace as it was meant"),
    "trace_fracture": Quantity("1", ("trace",), "index of the fracture that the trace is of"),
    "trace_flow": Quantity(
        "m3 s-1",
        ("elapsed_time", "trace"),
        "largest flow along the trace for unit depth, from its begin to its end positive",
        ("pressure_map",),
        comment="by differences of the pressures in the fracture",
    ),
    "fracture_node_x": Quantity("m", ("fracture_node",), "x of a node of the traces"),
    "fracture_node_y": Quantity("m", ("fracture_node",), "y of a node of the traces"),
    "fracture_node_pressure": Quantity(
        "Pa",
        ("elapsed_time", "fracture_node"),
        "pressure in the fracture at the node",
        ("pressure_map",),
        comment=SUPERPOSED,
    ),
    "branch_from": Quantity("1", ("branch",), "node at one end of the branch of a trace"),
    "branch_to": Quantity("1", ("branch",), "node at its other end"),
    "branch_fracture": Quantity("1", ("branch",), "index of the fracture that it belongs to"),
    "branch_aperture": Quantity("m", ("branch",), "hydraulic aperture of the branch"),
    "grain_x": Quantity(
        "m", ("grain",), "x of the grain centre", ("grain_map",), standard_name=X_NAME
    ),
    "grain_y": Quantity(
        "m", ("grain",), "y of the grain centre", ("grain_map",), standard_name=Y_NAME
    ),
    "radius": Quantity("m", ("grain",), "grain radius", ("grain_map",)),
    "normal_force": Quantity(
        "N m-1", ("contact",), "normal contact force, compression positive", ("grain_map",)
    ),
    "shear_force": Quantity("N m-1", ("contact",), "shear contact force", ("grain_map",)),
    "grain_a": Quantity("1", ("contact",), "first grain of the contact", ("grain_map",)),
    "grain_b": Quantity("1", ("contact",), "second grain of the contact", ("grain_map",)),
    "crack_x": Quantity("m", ("crack",), "x of the bond that broke", ("grain_map",)),
    "crack_y": Quantity("m", ("crack",), "y of the bond that broke", ("grain_map",)),
    "crack_mode": Quantity("1", ("crack",), "1 broken in tension, 2 in shear", ("grain_map",)),
    "crack_step": Quantity("1", ("crack",), "time step of the breakage", ("grain_map",)),
    "crack_strain_xx": Quantity(
        "1", ("crack",), "strain xx of the box by then, extension positive", ("grain_map",)
    ),
    "crack_strain_yy": Quantity(
        "1", ("crack",), "strain yy of the box by then, extension positive", ("grain_map",)
    ),
}

# Variables of one case's test to failure, besides the place and mode of its cracks.
TESTS: dict[str, Quantity] = {
    "axial_stress": Quantity("Pa", ("record",), "axial stress in the sense of the test"),
    "axial_strain": Quantity("1", ("record",), "axial strain in the sense of the test"),
    "lateral_strain": Quantity("1", ("record",), "lateral strain opposite to that sense"),
    "lateral_stress": Quantity("Pa", ("record",), "stress on the lateral walls"),
    "cracks": Quantity("1", ("record",), "bonds and joint contacts broken"),
    "crack_x": MAPS["crack_x"],
    "crack_y": MAPS["crack_y"],
    "crack_mode": MAPS["crack_mode"],
    "crack_step": MAPS["crack_step"],
    "crack_strain": Quantity("1", ("crack",), "axial strain of the test by the breakage"),
    "box": Quantity("m", ("wall",), "left, right, bottom and top wall before the test"),
}


def checked(found: Mapping[str, np.ndarray]) -> str:
    """Return why a case stopped early, "" where it did not.

    `found` is what was observed of it, by the names of `CASE`. Raises ModelError where a result
    is no number that must be one; after a stop there is none at any time.
    """
    stopped = str(found.get(STOPPED, ""))
    for name, array in found.items():
        if array.dtype.kind != "f":
            continue
        wrong = ~np.isfinite(array)
        if CASE[name].gaps or (stopped and "elapsed_time" in CASE[name].dimensions):
            wrong &= ~np.isnan(array)
        if count := np.count_nonzero(wrong):
            raise ModelError(
                f"{name} is not a finite number at {count} of {array.size} places; "
                "try another solver.method, or less extreme apertures and times"
            )
    return stopped
