"""Mesh the scene ``bolted_cover``: a cover on a housing, with holes for three bolts.

    python workflows/manual/cover_meshes.py [FOLDER]

from the root of a checkout writes ``cover.msh`` and ``housing.msh`` in mm, by gmsh, into
``workflows/scenes/bolted_cover``. The meshes of the two faces of the joint do not match.
"""

import sys
from pathlib import Path

from multiscale.io.gmsh_model import gmsh_model

FOLDER = Path(__file__).parents[1] / "scenes" / "bolted_cover"
SIZE = (60.0, 40.0)
"""Of both bodies in plan, mm."""
BOLTS = ((12.0, 20.0), (46.0, 10.0), (46.0, 30.0))
HOLE, WASHER = 6.6, 12.0
"""Diameters, mm."""


def main(folder: Path = FOLDER) -> None:
    """Write both meshes."""
    mesh_plate(folder / "housing.msh", -14.0, 0.0, 8.0)
    mesh_plate(folder / "cover.msh", 0.0, 8.0, 6.0)


def mesh_plate(file: Path, bottom: float, top: float, element: float) -> None:
    """Mesh a plate with holes by hexahedra, and name its faces.

    The face at z = 0 is ``joint``, the rings on the other side ``washer_0``, ..., the ends along x
    ``left`` and ``right``.
    """
    with gmsh_model(file.stem) as gmsh:
        occ = gmsh.model.occ
        sheet = [(2, occ.addRectangle(0.0, 0.0, bottom, *SIZE))]
        rings, holes = (
            [(2, occ.addDisk(*at, bottom, 0.5 * d, 0.5 * d)) for at in BOLTS]
            for d in (WASHER, HOLE)
        )
        plan = occ.cut(occ.fragment(sheet, rings)[0], holes)[0]
        occ.extrude(plan, 0.0, 0.0, top - bottom, numElements=[2], recombine=True)
        occ.synchronize()
        outer = bottom if top == 0.0 else top
        groups: dict[str, list[int]] = {}
        for _, face in gmsh.model.getEntities(2):
            x, y, z = occ.getCenterOfMass(2, face)
            low, high = (gmsh.model.getBoundingBox(2, face)[at] for at in (2, 5))
            if high - low > 0.1:  # an upright face
                ends = {"left": 0.0, "right": SIZE[0]}
                names = [name for name, end in ends.items() if abs(x - end) < 1e-6]
            else:
                middles = [abs(x - a) + abs(y - b) < 1e-6 for a, b in BOLTS]
                names = [
                    f"washer_{k}" for k, on in enumerate(middles) if on and abs(z - outer) < 0.1
                ]
                names += ["joint"] if abs(z) < 0.1 else []
            for name in names:
                groups.setdefault(name, []).append(face)
        for name, faces in groups.items():
            gmsh.model.addPhysicalGroup(2, faces, name=name)
        solids = [tag for _, tag in gmsh.model.getEntities(3)]
        gmsh.model.addPhysicalGroup(3, solids, name="solid")
        for name, value in (("RecombineAll", 1), ("SubdivisionAlgorithm", 1)):
            gmsh.option.setNumber(f"Mesh.{name}", value)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 2.0 * element)
        gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 6)
        gmsh.option.setNumber("Mesh.MshFileVersion", 2.2)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(file))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
