"""A small body with all its pores meshed, against a body with the stiffness of a volume of them."""

import numpy as np
import pytest

from multiscale.micro.damage import Cavities, random_spheres
from multiscale.pipeline import load_case, run
from tests.support import case_text, write_scene

EDGE, RADIUS, POROSITY = 2.0, 0.24, 0.08  # mm

BODY = case_text("porous_cube")
VOLUME = f"""
[rve]
youngs_modulus = "70 GPa"
poissons_ratio = 0.3
size = "1.5 mm"
voxels = 30
level = 0
sections = 3
[rve.recipe]
porosity = {POROSITY}
pore_radius = "{RADIUS} mm"
realisations = 5
"""
SOLID = 'youngs_modulus = "70 GPa"\npoissons_ratio = 0.3'


GROWN = 1.065
"""Radii of meshed over true pores: flat faces between points of a sphere take from its volume."""


def geometry(pores: Cavities) -> str:
    """Cube in mm without the pores, with named sides."""
    lines = ['SetFactory("OpenCASCADE");', "Mesh.MeshSizeFromCurvature = 8;"]
    lines += [f"Box(1) = {{0, 0, 0, {EDGE}, {EDGE}, {EDGE}}};"]
    spheres = [
        (centre, GROWN * root[0, 0])
        for kind in pores.images
        for centre, root in zip(kind.centre, kind.root, strict=True)
    ]
    for k, (centre, radius) in enumerate(spheres, start=2):
        lines.append(
            f"Sphere({k}) = {{{', '.join(f'{x!r}' for x in map(float, centre))}, {radius}}};"
        )
    if spheres:
        numbers = f"2:{len(spheres) + 1}"
        solid, voids = (f"{{ Volume{{{item}}}; Delete; }}" for item in (1, numbers))
        lines.append(f"BooleanDifference(5000) = {solid}{voids};")
    e = 1e-4
    for name, axis, at in (("left", 0, 0), ("front", 1, 0), ("bottom", 2, 0), ("top", 2, EDGE)):
        low, high = [-e] * 3, [EDGE + e] * 3
        low[axis], high[axis] = at - e, at + e
        box = ", ".join(f"{x:g}" for x in (*low, *high))
        lines.append(f"{name}() = Surface In BoundingBox {{{box}}};")
        lines.append(f'Physical Surface("{name}") = {{{name}()}};')
    lines.append('Physical Volume("cube") = Volume{:};')
    return "\n".join(lines)


@pytest.mark.slow
def test_a_body_with_all_pores_lies_in_the_interval_of_its_volume(tmp_path):
    pores = random_spheres((EDGE,) * 3, RADIUS, porosity=POROSITY, seed=101)
    (tmp_path / "pores.geo").write_text(geometry(pores), encoding="utf-8")
    (tmp_path / "cube.geo").write_text(geometry(Cavities((EDGE,) * 3)), encoding="utf-8")
    direct = BODY.format(mesh="pores.geo", element=0.3, moduli=SOLID)
    sequential = VOLUME + BODY.format(mesh="cube.geo", element=0.3, moduli="")
    case = load_case(write_scene(tmp_path, 'title = "All pores"' + direct))
    mesh = case.structure.bodies[0].load()
    edges = mesh.p[:, mesh.t[1:]] - mesh.p[:, mesh.t[:1]]
    solid = np.abs(np.linalg.det(edges.transpose(2, 0, 1))).sum() / 6.0
    assert 1.0 - solid / (1e-3 * EDGE) ** 3 == pytest.approx(POROSITY, rel=0.05)
    whole = float(run(case, tmp_path / "direct")["macro_result"]["load_stiffness"][-1, 0])
    case = load_case(write_scene(tmp_path, 'title = "A volume"' + sequential))
    part = run(case, tmp_path / "sequential")["macro_result"].isel(step=-1, load=0)
    low, high = part["load_stiffness_one_part"].to_numpy()
    sound = 70e9 * 1e-3 * EDGE
    assert low < whole < high < sound
    assert high - low < 0.3 * whole
    assert float(part["load_stiffness"]) == pytest.approx(whole, rel=0.05)
    assert np.isfinite(part["error_total"].to_numpy()).all()
