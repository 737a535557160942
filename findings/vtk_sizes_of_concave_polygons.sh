#!/usr/bin/env bash
# VTK 9.7.2: the area that vtkCellSizeFilter gives for a polygon that is not convex depends on the
# corner at which its list begins: the triangles that fan out from there are added without their
# signs. The same cell's own Triangulate cuts it right from any corner.
# Valid input: a VTK_POLYGON with four corners in order, one of them reflex; area 1.
# Seen: 1 from the reflex corner and from the one across, 3 from the two others. This script fails if
# that changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check vtk==9.7.2
"$folder/venv/bin/python" - <<'PY'
import vtk

CORNERS = [(0.0, 0.0), (2.0, -1.0), (1.0, 0.0), (2.0, 1.0)]


def areas(corners):
    """By the filter, and by the triangles of the cell."""
    points, ids = vtk.vtkPoints(), vtk.vtkIdList()
    points.SetDataTypeToDouble()
    for x, y in corners:
        ids.InsertNextId(points.InsertNextPoint(x, y, 0.0))
    grid = vtk.vtkUnstructuredGrid()
    grid.SetPoints(points)
    grid.InsertNextCell(vtk.VTK_POLYGON, ids)
    sizes = vtk.vtkCellSizeFilter()
    sizes.SetInputData(grid)
    sizes.Update()
    parts, order = vtk.vtkPoints(), vtk.vtkIdList()
    parts.SetDataTypeToDouble()
    grid.GetCell(0).Triangulate(0, order, parts)
    own = sum(
        vtk.vtkTriangle.TriangleArea(*(parts.GetPoint(k + n) for n in range(3)))
        for k in range(0, parts.GetNumberOfPoints(), 3)
    )
    return round(sizes.GetOutput().GetCellData().GetArray("Area").GetValue(0), 12), round(own, 12)


found = [areas(CORNERS[k:] + CORNERS[:k]) for k in range(4)]
print(*found)
assert found == [(1.0, 1.0), (3.0, 1.0), (1.0, 1.0), (3.0, 1.0)], found
PY
