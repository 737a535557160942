"""Polygons with values as VTK's XML files: unstructured grids (VTU), and their list in time (PVD).

The format is that of "VTK XML Formats" in VTK's documentation, arrays appended raw after the
markup, each behind its number of bytes (UInt64), little-endian.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from xml.sax.saxutils import quoteattr

import numpy as np

POLYGON = 7  # VTK_POLYGON: any number of corners, in order
# by NumPy's kind; unsigned are the kinds of cells alone
_TYPES = {"f": ("Float64", "<f8"), "i": ("Int64", "<i8"), "u": ("UInt8", "u1")}


def polygons_vtu(nodes: np.ndarray, faces: np.ndarray, fields: Mapping[str, np.ndarray]) -> bytes:
    """Return the bytes of a VTU file of polygons.

    Parameters
    ----------
    nodes : (n, 2) corners, m.
    faces : (polygons, most corners) indices of nodes in order, −1 where there is none.
    fields : (polygons,) values, by name.
    """
    there = faces >= 0
    corners = there.sum(axis=1)
    points = np.zeros((len(nodes), 3))
    points[:, :2] = nodes
    body = _Appended()
    cells = [
        body.array("connectivity", faces[there]),
        body.array("offsets", np.cumsum(corners)),
        body.array("types", np.full(len(faces), POLYGON, dtype=np.uint8)),
    ]
    place = body.array("points", points, components=3)
    data = [body.array(name, values) for name, values in fields.items()]
    first = quoteattr(next(iter(fields), ""))
    markup = (
        '<?xml version="1.0"?>\n'
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
        'header_type="UInt64">\n<UnstructuredGrid>\n'
        f'<Piece NumberOfPoints="{len(nodes)}" NumberOfCells="{len(faces)}">\n'
        f"<Points>{place}</Points>\n<Cells>{''.join(cells)}</Cells>\n"
        f"<CellData Scalars={first}>{''.join(data)}</CellData>\n"
        '</Piece>\n</UnstructuredGrid>\n<AppendedData encoding="raw">\n_'
    )
    return markup.encode() + body.content() + b"\n</AppendedData>\n</VTKFile>\n"


def pvd(times: Sequence[float] | np.ndarray, files: Sequence[str]) -> bytes:
    """Return the bytes of a PVD file: which file holds which time (s)."""
    lines = [
        f'<DataSet timestep="{float(t)!r}" part="0" file={quoteattr(name)}/>\n'
        for t, name in zip(times, files, strict=True)
    ]
    return (
        '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" '
        f'byte_order="LittleEndian">\n<Collection>\n{"".join(lines)}</Collection>\n</VTKFile>\n'
    ).encode()


class _Appended:
    """Arrays that follow the markup, which says where each begins."""

    def __init__(self) -> None:
        self.blocks: list[bytes] = []
        self.offset = 0

    def array(self, name: str, values: np.ndarray, components: int = 1) -> str:
        """Take an array; return the markup that stands for it."""
        kind, dtype = _TYPES.get(values.dtype.kind, _TYPES["i"])
        content = np.ascontiguousarray(values, dtype=dtype).tobytes()
        block = struct.pack("<Q", len(content)) + content
        markup = (
            f"<DataArray type={quoteattr(kind)} Name={quoteattr(name)} "
            f'NumberOfComponents="{components}" format="appended" offset="{self.offset}"/>'
        )
        self.blocks.append(block)
        self.offset += len(block)
        return markup

    def content(self) -> bytes:
        """All arrays, one behind the other."""
        return b"".join(self.blocks)
