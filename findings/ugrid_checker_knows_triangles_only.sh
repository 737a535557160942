#!/usr/bin/env bash
# cc-plugin-ugrid 1.1.0 with compliance-checker 6.1.0: UGRID 1.0 lets faces have any number of
# corners (missing ones filled) and dimensions any name. The plugin's check asks for a dimension
# that is literally called `nfaces`; on any other valid mesh it stops with that name in the log, and
# the report has no finding, as if all were well.
# Valid input: one quadrilateral and one triangle, dimension `face`.
# Seen: KeyError 'nfaces' from UGRID.check_run or no result of it. This script fails if that changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
  compliance-checker==6.1.0 cc-plugin-ugrid==1.1.0
cd "$folder"
"$folder/venv/bin/python" - <<'PY'
import netCDF4
import numpy as np

with netCDF4.Dataset("mesh.nc", "w") as file:
    file.Conventions = "CF-1.11 UGRID-1.0"
    for name, size in (("node", 5), ("face", 2), ("corner", 4)):
        file.createDimension(name, size)
    mesh = file.createVariable("mesh", "i4")
    mesh.cf_role, mesh.topology_dimension = "mesh_topology", np.int32(2)
    mesh.node_coordinates, mesh.face_node_connectivity = "x y", "faces"
    mesh.face_dimension = "face"
    for name, values in (("x", [0, 1, 1, 0, 2]), ("y", [0, 0, 1, 1, 0.5])):
        node = file.createVariable(name, "f8", ("node",))
        node.units, node[:] = "m", values
    faces = file.createVariable("faces", "i4", ("face", "corner"), fill_value=-1)
    faces.cf_role, faces.start_index = "face_node_connectivity", np.int32(0)
    faces[:] = np.ma.masked_equal([[0, 1, 2, 3], [1, 4, 2, -1]], -1)
PY
"$folder/venv/bin/compliance-checker" --test=ugrid mesh.nc > report.txt 2> log.txt || true
cat report.txt log.txt | grep -m1 nfaces && exit 0
echo "changed: the plugin takes faces of any name now" >&2
cat report.txt log.txt >&2
exit 1
