"""One case: everything that the model reads, frozen, in SI units, checked when it is made.

The dataclasses mirror the blocks of a study file, so that a path such as
`wells.producer.rate` means the same in both. Angles are in radians, stresses
positive in compression, rates positive when a well produces. The model is two
dimensional with unit depth: rates are m³/s for one metre of rock.
"""

from demflow.model.parameters import SceneError
from demflow.model.region import Circle, Hole, Pierced, Polygon, Rectangle, Region, Shape
from demflow.model.scene.case import (
    MEASURED_BY_A_TEST,
    OBSERVABLES,
    OF_BREAKING,
    OF_COUPLING,
    Scene,
)
from demflow.model.scene.closure import BartonBandis, Closure
from demflow.model.scene.coupling import Coupling, Reckoned, one_way_ratio
from demflow.model.scene.distributions import (
    Exponential,
    LengthPower,
    LogNormal,
    PowerLaw,
    Uniform,
    VonMises,
)
from demflow.model.scene.flow import (
    LEAST_TOLERANCE,
    Fluid,
    Inflow,
    InflowSide,
    InitialField,
    Matrix,
    Probe,
    Solver,
    Well,
)
from demflow.model.scene.fractures import (
    BiWing,
    Fracture,
    FractureSet,
    Joint,
    RandomSet,
    Trace,
    TraceMap,
)
from demflow.model.scene.ground import (
    CircularHole,
    Excavation,
    Ground,
    PolygonalHole,
    RectangularHole,
    holes_of,
)
from demflow.model.scene.lines import (
    FlowLine,
    JointLine,
    Line,
    acting_lines,
    flow_lines,
    joint_lines,
    lines_of,
    refined_places,
)
from demflow.model.scene.rock import Bonds, Contact, FailureTest, Grains, Refinement, Stress
from demflow.model.scene.trace_maps import MapFile

__all__ = [
    "LEAST_TOLERANCE",
    "MEASURED_BY_A_TEST",
    "OBSERVABLES",
    "OF_BREAKING",
    "OF_COUPLING",
    "BartonBandis",
    "BiWing",
    "Bonds",
    "Circle",
    "CircularHole",
    "Closure",
    "Contact",
    "Coupling",
    "Excavation",
    "Exponential",
    "FailureTest",
    "FlowLine",
    "Fluid",
    "Fracture",
    "FractureSet",
    "Grains",
    "Ground",
    "Hole",
    "Inflow",
    "InflowSide",
    "InitialField",
    "Joint",
    "JointLine",
    "LengthPower",
    "Line",
    "LogNormal",
    "MapFile",
    "Matrix",
    "Pierced",
    "Polygon",
    "PolygonalHole",
    "PowerLaw",
    "Probe",
    "RandomSet",
    "Reckoned",
    "Rectangle",
    "RectangularHole",
    "Refinement",
    "Region",
    "Scene",
    "SceneError",
    "Shape",
    "Solver",
    "Stress",
    "Trace",
    "TraceMap",
    "Uniform",
    "VonMises",
    "Well",
    "acting_lines",
    "flow_lines",
    "holes_of",
    "joint_lines",
    "lines_of",
    "one_way_ratio",
    "refined_places",
]
