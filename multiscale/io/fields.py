"""Fields of cells, links, bodies and grains as VTU files for ParaView."""

from collections.abc import Iterable, Iterator
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from multiscale.errors import SchemaError
from multiscale.io.files import replacing, write_bytes
from multiscale.schema import GRANULATE, MACRO_RESULT, VIBRATION, Dataset

KINDS = {2: "line", 4: "tetra", 8: "hexahedron"}  # in meshio, by the number of corners
NODES = ("displacement", "velocity", "rotation", "shape")  # variables of nodes
LINKS = ("tension", "slack", "impulse")  # of links
ELEMENTS = ("equivalent_stress", "energy_density", "element_body", "element_damage")
LIFE = ("damage", "cracked_share", "plastic_strain", "first_crack", "equivalent_amplitude")
POINTS = ("gap", "contact_state", "point_joint", "point_damage")  # of the points of joints


def write_surface_fields(fields: Dataset, size: tuple[float, float], folder: Path) -> None:
    """Write a VTU file per step: the surface as quadrilaterals with pressure, Pa, and gap, m."""
    ny, nx = fields["height"].shape
    x, y = (np.arange(n) * length / n for n, length in zip((nx, ny), size, strict=True))
    points = np.column_stack(
        [*(axis.ravel() for axis in np.meshgrid(x, y)), fields["height"].values.ravel()]
    )
    first = (np.arange(ny - 1)[:, None] * nx + np.arange(nx - 1)).ravel()
    quads = np.column_stack([first, first + 1, first + nx + 1, first + nx])
    for k in range(fields.sizes["step"]):
        data = {name: fields[name].values[k].ravel() for name in ("pressure", "gap")}
        _write(_mesh(points, "quad", quads, data), folder / f"contact-{k:04d}.vtu")


def write_link_fields(result: Dataset, folder: Path, *, name: str = "links") -> Path:
    """Write the links as lines between their nodes, with any tension and slack, at every step."""
    _require(result, ("position", "ends", "displacement"), "nodes and links")
    meshes = ({"": _structure(frame, "ends", LINKS)} for frame in _frames(result, "step"))
    return _write_series(folder, name, _timesteps(result), meshes)


def write_body_fields(result: Dataset, folder: Path, *, name: str = "bodies") -> Path:
    """Write the elements of every step, and the points of joints as a second part."""
    _require(result, ("position", "displacement", "corners"), "elastic bodies")
    parts = (
        {"": _structure(frame, "corners", ELEMENTS)}
        | ({"joints": _joints(frame)} if "traction" in frame else {})
        for frame in _frames(result, "step")
    )
    return _write_series(folder, name, _timesteps(result), parts)


def _joints(frame: Dataset) -> Any:
    """Points of joints with pressure and magnitude of the shear traction, Pa, gap and state."""
    traction, place = frame["traction"].values, frame["point_position"].values
    values = {"pressure": -traction[:, 0], "shear": np.hypot(traction[:, 1], traction[:, 2])}
    values |= {key.removeprefix("point_"): value for key, value in _values(frame, POINTS).items()}
    return _mesh(place, "vertex", np.arange(len(place))[:, None], values)


def write_mode_fields(result: Dataset, folder: Path, *, name: str = "modes") -> Path:
    """Write the shape of every mode on the elements, as a series over their numbers."""
    VIBRATION.check(result)
    meshes = ({"": _structure(mode, "corners", ELEMENTS)} for mode in _frames(result, "mode"))
    return _write_series(folder, name, result["mode"].values, meshes)


def write_life_fields(life: Dataset, folder: Path, *, name: str = "life") -> Path:
    """Write the elements of a body with their damage and life, as a VTU file."""
    mesh = _structure(life, "corners", LIFE)
    return _write_series(folder, name, life["cycles"].values[-1:], [{"": mesh}])


def write_grain_fields(result: Dataset, folder: Path, *, name: str = "grains") -> Path:
    """Write grains as points with radius, velocity and spin, and contacts as lines with force."""
    GRANULATE.check(result)
    time = np.append(0.0, result["time"].values)[result["frame_step"].values + 1]
    frames = ({"": _frame(result, k)} for k in range(result.sizes["frame"]))
    return _write_series(folder, name, time, frames)


def _frame(result: Dataset, k: int) -> Any:
    """Points of the grains and lines of their contacts in a frame."""
    import meshio

    n, frame = result.sizes["grain"], result.isel(frame=k)
    here = result["contact_frame"].values == k
    first = frame["position"].values[result["contact_ends"].values[here, 0]]
    second = first - result["branch"].values[here]  # a contact across a period stays short
    force = np.linalg.norm(result["contact_force"].values[here], axis=1)
    m = len(force)
    grains = {
        "radius": result["radius"].values,
        **{name: frame[name].values for name in ("velocity", "spin") if name in frame},
    }
    return meshio.Mesh(
        np.concatenate([frame["position"].values, first, second]),
        [("vertex", np.arange(n)[:, None]), ("line", n + np.arange(2 * m).reshape(2, m).T)],
        point_data={
            key: np.concatenate([value, np.zeros((2 * m, *value.shape[1:]))])
            for key, value in grains.items()
        },
        cell_data={"force": [np.zeros(n), force]},
    )


def _frames(result: Dataset, dim: str) -> Iterator[Dataset]:
    return (result.isel({dim: k}) for k in range(result.sizes[dim]))


def _values(frame: Dataset, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    return {name: frame[name].values for name in names if name in frame}


def _structure(frame: Dataset, cells: str, values: tuple[str, ...]) -> Any:
    """Mesh of links or elements, with data of nodes and of each cell."""
    corners = frame[cells].values.astype(int)
    position, kind = frame["position"].values, KINDS[corners.shape[1]]
    return _mesh(position, kind, corners, _values(frame, NODES), _values(frame, values))


def _mesh(
    points: np.ndarray,
    kind: str,
    cells: np.ndarray,
    nodes: dict[str, np.ndarray] | None = None,
    elements: dict[str, np.ndarray] | None = None,
) -> Any:
    """Mesh of a single kind of cell, with data of its nodes and elements."""
    import meshio

    data = {name: [values] for name, values in (elements or {}).items()}
    return meshio.Mesh(points, [(kind, cells)], nodes, data)


def _write(mesh: Any, path: Path) -> None:
    with replacing(path) as temporary:
        mesh.write(temporary, file_format="vtu")


def _require(result: Dataset, names: tuple[str, ...], kind: str) -> None:
    """Refuse a result without the variables of a kind of structure."""
    MACRO_RESULT.check(result)
    if missing := [needed for needed in names if needed not in result]:
        raise SchemaError(f"the result has no {', '.join(missing)}: it is not a result of {kind}")


def _timesteps(result: Dataset) -> np.ndarray:
    """Return rising times, s, or load factors of the steps of a result, else their numbers."""
    for name in ("time", "load_factor"):
        if name in result.coords and np.all(np.diff(result[name].values) > 0.0):
            return np.asarray(result[name].values)
    return np.arange(result.sizes["step"])


def _write_series(
    folder: Path, name: str, times: np.ndarray, steps: Iterable[dict[str, Any]]
) -> Path:
    """Write a VTU file for each step and part (``""`` is the main part), and their collection."""
    entries = []
    for k, (at, meshes) in enumerate(zip(times, steps, strict=True)):
        for number, (part, mesh) in enumerate(meshes.items()):
            file = f"{name}-{part}-{k:04d}.vtu" if part else f"{name}-{k:04d}.vtu"
            _write(mesh, folder / file)
            entries.append(
                f'    <DataSet timestep="{float(at)!r}" part="{number}" file="{escape(file)}"/>\n'
            )
    collection = folder / f"{name}.pvd"  # written last: it names only existing files
    text = (
        '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n  <Collection>\n'
        + "".join(entries)
        + "  </Collection>\n</VTKFile>\n"
    )
    write_bytes(collection, text.encode())
    return collection
