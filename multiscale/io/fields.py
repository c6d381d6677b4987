"""Fields of cells, links, bodies and grains as VTU files for ParaView."""

from collections.abc import Iterable
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from multiscale.errors import SchemaError
from multiscale.io.files import replacing, write_bytes
from multiscale.schema import GRANULATE, MACRO_RESULT, VIBRATION, Dataset

LINK_VARIABLES = ("tension", "slack", "impulse")  # of links at every step
NODE_VARIABLES = ("displacement", "velocity", "rotation")  # of nodes at every step
ELEMENTS = {4: "tetra", 8: "hexahedron"}  # in meshio, by the number of corners
ELEMENT_VARIABLES = ("equivalent_stress", "energy_density")  # of elements at every step
CONSTANT_VARIABLES = ("element_body", "element_damage")  # of elements without steps
LIFE_VARIABLES = ("damage", "cracked_share", "plastic_strain", "first_crack")  # of elements
POINT_VARIABLES = ("gap", "contact_state")  # of the points of joints at every step


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
    """Write a VTU file per step, and the collection that ParaView opens as a series.

    The links are lines between the nodes of the unloaded structure, with tension and slack;
    the filter *Warp By Vector* with the displacement of the nodes moves them.
    """
    _require(result, ("position", "ends", "tension"), "nodes and links")
    position, ends = result["position"].values, result["ends"].values

    def links(step: int) -> dict[str, Any]:
        nodes, values = (_values(result, names, step) for names in (NODE_VARIABLES, LINK_VARIABLES))
        return {"": _mesh(position, "line", ends, nodes, values)}

    steps = range(result.sizes["step"])
    return _write_series(folder, name, _timesteps(result), map(links, steps))


def write_body_fields(result: Dataset, folder: Path, *, name: str = "bodies") -> Path:
    """Write the elements of every step, and the points of joints as a second part.

    The filter *Warp By Vector* with the displacement of the nodes moves the bodies. Points have
    gap, m, pressure and magnitude of the shear traction, Pa, ``contact_state`` (0 open, 1 sticks,
    2 slips), damage and number of their joint. Elements have von Mises stress, Pa, density of the
    strain energy, J/m³, damage and number of their body.
    """
    _require(result, ("position", "displacement", "corners"), "elastic bodies")
    position, corners = result["position"].values, result["corners"].values

    def parts(step: int) -> dict[str, Any]:
        values = _values(result, ELEMENT_VARIABLES, step) | _values(result, CONSTANT_VARIABLES)
        moved = {"displacement": result["displacement"].values[step]}
        bodies = _mesh(position, ELEMENTS[corners.shape[1]], corners, moved, values)
        if "traction" not in result:
            return {"": bodies}
        traction, points = result["traction"].values[step], result["point_position"].values
        joints = {
            "pressure": -traction[:, 0],
            "shear": np.hypot(traction[:, 1], traction[:, 2]),
            **_values(result, POINT_VARIABLES, step),
            **{key: result[f"point_{key}"].values for key in ("joint", "damage")},
        }
        vertices = np.arange(len(points))[:, None]
        return {"": bodies, "joints": _mesh(points, "vertex", vertices, joints)}

    steps = range(result.sizes["step"])
    return _write_series(folder, name, _timesteps(result), map(parts, steps))


def write_mode_fields(result: Dataset, folder: Path, *, name: str = "modes") -> Path:
    """Write the shape of every mode on the elements, as a series over their numbers.

    The filter *Warp By Vector* with ``shape``, kg^-1/2, times a modal amplitude moves the bodies.
    """
    VIBRATION.check(result)
    position, corners = result["position"].values, result["corners"].values
    kind, body = ELEMENTS[corners.shape[1]], {"element_body": result["element_body"].values}
    meshes = (
        {"": _mesh(position, kind, corners, {"shape": shape}, body)}
        for shape in result["shape"].values
    )
    return _write_series(folder, name, result["mode"].values, meshes)


def write_life_fields(life: Dataset, folder: Path, *, name: str = "life") -> Path:
    """Write the elements of a body with their damage and life, as a VTU file.

    Elements have the mean damage and plastic strain of their inclusions, the share of these that
    has cracked, the cycles to the first crack and the von Mises amplitude, Pa.
    """
    values = {key: life[key].values for key in (*LIFE_VARIABLES, "equivalent_amplitude")}
    corners = life["corners"].values.astype(int)
    mesh = _mesh(life["position"].values, ELEMENTS[corners.shape[1]], corners, elements=values)
    return _write_series(folder, name, life["cycles"].values[-1:], [{"": mesh}])


def write_grain_fields(result: Dataset, folder: Path, *, name: str = "grains") -> Path:
    """Write a VTU file per frame, and the collection that ParaView opens as a series.

    A grain is a point with its radius, m, velocity, m/s, and, if grains turn, spin, rad/s. The
    filter *Glyph* shows it as a sphere scaled by twice the radius. A contact is a line with its
    force, N.
    """
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


def _values(result: Dataset, names: tuple[str, ...], step: Any = ...) -> dict[str, np.ndarray]:
    """Values of the variables that a result has, at a step or without steps."""
    return {name: result[name].values[step] for name in names if name in result}


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
