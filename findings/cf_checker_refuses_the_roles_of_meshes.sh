#!/usr/bin/env bash
# compliance-checker 6.1.0 (netCDF4 1.7.4, numpy 2.4): its check against CF 1.11 calls the attribute
# cf_role of a UGRID mesh an error, wants at most one variable with it, and takes the faces of a mesh
# for instances of a discrete sampling geometry. CF 1.11 (section 5.9 and appendix K) takes meshes
# from UGRID 1.0, which requires cf_role "mesh_topology" and "face_node_connectivity".
# Valid input: one triangle with a value. ugrid-checks 0.2.0 finds nothing wrong with it.
# Seen: three messages under "§9.5 Coordinates and metadata". This script fails if that changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
  compliance-checker==6.1.0 ugrid-checks==0.2.0
cd "$folder"
"$folder/venv/bin/python" - <<'PY'
import netCDF4
import numpy as np
from compliance_checker.cf.cf_1_11 import CF1_11Check
from ugrid_checks.check import check_dataset

with netCDF4.Dataset("mesh.nc", "w") as file:
    file.Conventions = "CF-1.11 UGRID-1.0"
    for name, size in (("node", 3), ("face", 1), ("corner", 3)):
        file.createDimension(name, size)
    mesh = file.createVariable("mesh", "i4")
    mesh.cf_role, mesh.topology_dimension = "mesh_topology", np.int32(2)
    mesh.node_coordinates, mesh.face_node_connectivity = "x y", "corners"
    corners = file.createVariable("corners", "i4", ("face", "corner"))
    corners.cf_role, corners.start_index = "face_node_connectivity", np.int32(0)
    corners[:] = [[0, 1, 2]]
    for name, values in (("x", [0.0, 1.0, 0.0]), ("y", [0.0, 0.0, 1.0])):
        place = file.createVariable(name, "f8", ("node",))
        place.units, place.standard_name = "m", f"projection_{name}_coordinate"
        place[:] = values
    value = file.createVariable("value", "f8", ("face",))
    value.units, value.long_name, value.mesh, value.location = "1", "value", "mesh", "face"
    value[:] = 1.0

log = check_dataset("mesh.nc", print_summary=False).logger
assert log.N_FAILURES == log.N_WARNINGS == 0, (log.N_FAILURES, log.N_WARNINGS)

check = CF1_11Check()
file = netCDF4.Dataset("mesh.nc")
check.setup(file)
told = [*check.check_cf_role(file).msgs, *check.check_single_cf_role(file).msgs]
print(*told, sep="\n")
assert sum("is not a valid cf_role value" in message for message in told) == 2, told
assert any("only be one variable" in message for message in told), told
PY
