"""The deposit of grains by YADE, a code of discrete elements, where it is installed."""

import json
import os
import subprocess
import tempfile
from dataclasses import dataclass
from math import sqrt
from pathlib import Path

from multiscale.errors import ConvergenceError
from multiscale.io import read_text, write_bytes
from multiscale.macro.granulate import Model

__all__ = ["PROGRAM", "Settled", "settle", "time_step"]

PROGRAM = "yade"
YOUNGS_MODULUS = 1e7
"""Young's modulus, Pa: soft, for long explicit steps; overlaps reach .5 % of a radius."""
SAFE = 0.3
"""Length of a step over the time of a wave through a radius, dimensionless."""

SCRIPT = """
import json
import numpy as np
from yade import O, utils

given = json.load(open("grains.json"))
radius, density, youngs = given["radius"], given["density"], given["youngs_modulus"]
# springs of the stiffness E R, critically damped along the normal: no restitution
half = density * 4.0 / 3.0 * np.pi * radius[0] ** 3 / 2.0
stiffness = youngs * radius[0]
O.materials.append(ViscElMat(
    density=density, frictionAngle=np.arctan(given["friction"]), kn=2.0 * stiffness, ks=stiffness,
    cn=4.0 * np.sqrt(half * stiffness), cs=0.0))
for centre, r in zip(given["position"], radius):
    O.bodies.append(utils.sphere(centre, r))
x, y = given["size"]
for place, axis, side in ((0, 0, 1), (x, 0, -1), (0, 1, 1), (y, 1, -1), (0, 2, 1)):
    O.bodies.append(utils.wall(place, axis, sense=side))
O.engines = [
    ForceResetter(),
    InsertionSortCollider([Bo1_Sphere_Aabb(), Bo1_Wall_Aabb()]),
    InteractionLoop([Ig2_Sphere_Sphere_ScGeom(), Ig2_Wall_Sphere_ScGeom()],
                    [Ip2_ViscElMat_ViscElMat_ViscElPhys()], [Law2_ScGeom_ViscElPhys_Basic()]),
    NewtonIntegrator(damping=0.0, gravity=given["gravity"]),
]
steps = int(np.ceil(given["duration"] / given["step"]))
O.dt = given["duration"] / steps
O.run(steps, True)
z = np.array([b.state.pos[2] for b in O.bodies if isinstance(b.shape, Sphere)])
overlap = np.array([i.geom.penetrationDepth for i in O.interactions if i.isReal])
json.dump({
    "height": 2.0 * z.mean(), "contacts": int((overlap > 0.0).sum()),
    "overlap": overlap.max() / radius[0], "steps": steps}, open("settled.json", "w"))
"""


@dataclass(frozen=True)
class Settled:
    """A deposit at the end.

    Attributes
    ----------
    height : float, twice the mean height of the centres, m
    contacts, steps : int, numbers of overlapping pairs and of time steps
    overlap : float, largest overlap relative to the radius
    """

    height: float
    contacts: int
    steps: int
    overlap: float


def time_step(model: Model) -> float:
    """Return the length of the steps of YADE for grains of one size and density, s."""
    grains = model.grains
    density = float(grains.mass[0] / grains.volume[0])
    return SAFE * float(grains.radius[0]) * sqrt(density / YOUNGS_MODULUS)


def settle(model: Model, duration: float, *, threads: int = 1) -> Settled:
    """Solve the fall of the grains of a deposit, from the same positions.

    Notes
    -----
    Contacts are linear springs of the stiffness E R with critical damping along the normal, which
    leaves no restitution; a step is 0.3 of the time that a wave takes through a radius.

    References
    ----------
    .. [1] V. Šmilauer et al., Yade Documentation, 3rd ed. (2021), doi:10.5281/zenodo.5705394.
    """
    grains, walls = model.grains, model.walls
    case = {
        "position": grains.position.tolist(),
        "radius": grains.radius.tolist(),
        "density": float(grains.mass[0] / grains.volume[0]),
        "friction": model.law.friction,
        "gravity": list(model.gravity),
        "size": [walls[1].point[0], walls[3].point[1]],
        "duration": duration,
        "youngs_modulus": YOUNGS_MODULUS,
        "step": time_step(model),
    }
    own = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    with tempfile.TemporaryDirectory() as folder:
        write_bytes(Path(folder) / "grains.json", json.dumps(case).encode())
        write_bytes(Path(folder) / "deposit.py", SCRIPT.encode())
        ran = subprocess.run(
            [PROGRAM, "-n", "-x", f"-j{threads}", "deposit.py"],
            cwd=folder,
            env=own,
            capture_output=True,
            text=True,
            check=False,
        )
        answer = Path(folder) / "settled.json"
        if not answer.exists():
            last = (ran.stderr.strip() or ran.stdout.strip() or "nothing").splitlines()[-1]
            raise ConvergenceError(f"YADE left no deposit, its last line is: {last}")
        return Settled(**json.loads(read_text(answer)))
