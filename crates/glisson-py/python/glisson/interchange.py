"""Meshes and fields to and from meshio and PyVista, which are not needed otherwise (pip install meshio pyvista).

Places are in metres here, as everywhere in Glisson's Python; files that Glisson writes are in millimetres (``Mesh.save``, ``Series``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glisson._glisson import Mesh, Surface, World

Source: TypeAlias = Mesh | Surface | World
Fields: TypeAlias = Mapping[str, ArrayLike]

#: VTK's number of a cell of four nodes.
_TETRAHEDRON = 10


def _geometry(source: Source) -> tuple[NDArray[np.float64], str, NDArray[np.uint32]]:
    """Places [m], kind of cells as meshio calls it, and their nodes."""
    if isinstance(source, Surface):
        return source.positions_m, "triangle", source.triangles
    return source.positions_m, "tetra", source.tetrahedra


def _split(source: Source, fields: Fields | None) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[Any]]]:
    """Fields at nodes and in cells, by how long they are; a world brings its own at nodes."""
    points, _, cells = _geometry(source)
    own: dict[str, ArrayLike] = {}
    if isinstance(source, World):
        own = {
            "displacement_m": source.positions_m - source.rest_positions_m,
            "velocity_m_per_s": source.velocities_m_per_s,
            "strain": source.strain,
            "stress_pa": source.stress_pa,
        }
    at_nodes: dict[str, NDArray[Any]] = {}
    in_cells: dict[str, NDArray[Any]] = {}
    for name, given in {**own, **(fields or {})}.items():
        values = np.asarray(given)
        n = values.shape[0] if values.ndim else 0
        if n == len(points):
            at_nodes[name] = values
        elif n == len(cells):
            in_cells[name] = values
        else:
            raise ValueError(f"the field {name} has the shape {values.shape}; there are {len(points)} nodes and {len(cells)} cells")
    return at_nodes, in_cells


def to_meshio(source: Source, fields: Fields | None = None) -> Any:
    """A ``meshio.Mesh`` of a mesh, a surface, or a world as it is now, with ``fields`` at nodes or in cells."""
    import meshio  # type: ignore[import-not-found,import-untyped,unused-ignore]

    points, kind, cells = _geometry(source)
    at_nodes, in_cells = _split(source, fields)
    cell_data = {name: [values] for name, values in in_cells.items()}
    return meshio.Mesh(points, [(kind, cells.astype(np.int64))], point_data=at_nodes, cell_data=cell_data)


def from_meshio(mesh: Any, scale: float = 1.0) -> Mesh | Surface:
    """The tetrahedra of a ``meshio.Mesh``, or where it has none its triangles; its numbers times ``scale`` are metres (1e-3 for mm)."""
    points = np.asarray(mesh.points, float) * scale
    for kind, make in (("tetra", Mesh), ("triangle", Surface)):
        blocks = [block.data for block in mesh.cells if block.type == kind]
        if blocks:
            return _without_loose(make, points, np.concatenate(blocks))
    kinds = ", ".join(sorted({block.type for block in mesh.cells})) or "none"
    raise ValueError(f"there is neither a tetrahedron nor a triangle of 3 nodes in it; cells: {kinds}")


def to_pyvista(source: Source, fields: Fields | None = None) -> Any:
    """A ``pyvista.UnstructuredGrid`` of a mesh, or of a world as it is now; of a surface a ``pyvista.PolyData``. With ``fields`` at nodes or
    in cells."""
    import pyvista  # type: ignore[import-not-found,import-untyped,unused-ignore]

    points, kind, cells = _geometry(source)
    at_nodes, in_cells = _split(source, fields)
    n_corners = cells.shape[1]
    rows = np.hstack([np.full((len(cells), 1), n_corners, np.int64), cells.astype(np.int64)])
    if kind == "triangle":
        grid = pyvista.PolyData(points.copy(), rows.ravel())
    else:
        grid = pyvista.UnstructuredGrid(rows.ravel(), np.full(len(cells), _TETRAHEDRON, np.uint8), points.copy())
    grid.point_data.update(at_nodes)
    grid.cell_data.update(in_cells)
    return grid


def from_pyvista(data: Any, scale: float = 1.0) -> Mesh | Surface:
    """The tetrahedra of a PyVista grid, or the triangles of its ``PolyData``; its numbers times ``scale`` are metres (1e-3 for mm)."""
    points = np.asarray(data.points, float) * scale
    if hasattr(data, "faces"):
        faces = np.asarray(data.triangulate().faces).reshape(-1, 4)[:, 1:]
        return _without_loose(Surface, points, faces)
    tetrahedra = getattr(data, "cells_dict", {}).get(_TETRAHEDRON)
    if tetrahedra is None:
        raise ValueError("there is no tetrahedron of 4 nodes in it: data.extract_surface() is a surface, which can be meshed")
    return _without_loose(Mesh, points, tetrahedra)


def _without_loose(make: type[Mesh] | type[Surface], points: NDArray[np.float64], cells: NDArray[Any]) -> Mesh | Surface:
    """Of the points those that cells have, in their order."""
    used, corners = np.unique(cells, return_inverse=True)
    return make(points[used], corners.reshape(cells.shape))
