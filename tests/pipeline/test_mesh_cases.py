"""Cases with cells from meshes: of a graph with any element, or from a file of the user."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.io import open_dataset
from multiscale.micro import Path, run_ensemble, solve_cell
from multiscale.pipeline import load_case, make_cells, requirements, run
from multiscale.schema import INTERFACE_LAW, MICRO_RESPONSE
from tests.voxels import write_voxels

CELL = {"size": ["1 um", "1 um"], "points": [8, 8], "layers": 4, "geometry": "mesh"}
NO_FILE = {"mesh": None, "unit": None}
PORES = {"porosity": "0.1", "radius": "0.2 um", "cover": "0.2 um"}
PRESSURES = ["10 MPa", "40 MPa", "160 MPa", "400 MPa"]


def written(path, cell=CELL, *, rough=True, realisations=2, **tables):
    """Write a case of cells of one steel body against another body."""
    import tomli_w

    surface = {
        "rms_slope": "0.05",
        "hurst_exponent": "0.8",
        "long_cutoff": "1 um",
        "short_cutoff": "0.5 um",
    }
    steel = {"youngs_modulus": "200 GPa", "poissons_ratio": "0.3"}
    content = {
        "title": "a mesh",
        "elastic": True,
        "body_1": steel | ({"surface": surface} if rough else {}),
        "body_2": steel,
        "cell": cell,
        "micro": {"realisations": realisations, "pressures": PRESSURES, "spots": True},
        "law": {"samples": 0},
    } | tables
    path.write_text(tomli_w.dumps(content), encoding="utf-8")
    return path


def mushroom(*, pore=False):
    """Voxels of a cap with an overhang on a stem on a block."""
    filled = np.zeros((8, 8, 8), dtype=bool)
    filled[:, :, :4] = True
    filled[3:5, 3:5, 4:6] = True
    filled[1:7, 1:7, 6:] = True
    if pore:
        filled[2:6, 2:6, 1:3] = False
    return filled


def of_file(path, **settings):
    return CELL | {"mesh": str(path), "unit": "1 um"} | settings


def test_a_case_of_meshes_has_the_response_of_conforming_cells(tmp_path):
    results = {}
    for geometry in ("mesh", "conforming"):
        case = load_case(written(tmp_path / f"{geometry}.toml", CELL | {"geometry": geometry}))
        path = Path(pressure=case.micro.path)
        results[geometry] = run_ensemble(make_cells(case), path, folder=tmp_path / geometry)
    for name in ("mean_gap", "contact_fraction", "rms_slope", "traction"):
        other = results["conforming"][name].values
        np.testing.assert_allclose(
            results["mesh"][name].values, other, atol=1e-6 * np.max(np.abs(other))
        )


def test_a_mesh_with_overhang_and_inclusion_goes_through_the_chain(tmp_path):
    filled = mushroom()
    inclusion = np.zeros(filled.shape, dtype=int)
    inclusion[2:6, 2:6, 1:3] = 1
    file = write_voxels(tmp_path / "rve.msh", filled, inclusion)
    moduli = {"poissons_ratio": "0.3"}
    stiffness = []
    for k, stiff in enumerate(("200 GPa", "2 GPa")):
        volumes = {"matrix": moduli | {"youngs_modulus": "200 GPa"}}
        volumes["inclusion"] = moduli | {"youngs_modulus": stiff}
        cell = of_file("rve.msh", volumes=volumes)
        path = written(tmp_path / f"{k}.toml", cell, rough=False, realisations=1)
        results = run(load_case(path), tmp_path / str(k))
        response = results[MICRO_RESPONSE.name]
        assert response["converged"].values.all()
        p = response["nominal_pressure"].values
        np.testing.assert_allclose(response["traction"][0, :, 0], -p, rtol=1e-8)
        area = response["contact_fraction"].values  # of the cap with corners that bend away
        assert np.all((area > 25 / 64) & (area <= 36 / 64))
        spots = response["spot_area"].sum("spot").values * 1e12  # of a cell of 1 um2
        np.testing.assert_allclose(spots, area, rtol=1e-12)
        gap = response["mean_gap"].values[0]
        stiffness.append((p[-1] - p[0]) / (gap[0] - gap[-1]))
        fields = open_dataset(tmp_path / str(k) / "fields" / "fields.nc")
        assert fields["pressure"].shape == (4, 8, 8)
        assert fields["pressure"].values[:, 0].max() == 0.0  # around the cap
        assert INTERFACE_LAW.name in results
    assert file.exists()
    assert stiffness[1] < 0.9 * stiffness[0]


def test_pores_of_a_recipe_lie_below_the_cover_and_differ_between_cells(tmp_path):
    cell = CELL | {"layers": 8, "depth": "1.2 um"}
    solid, porous = (
        make_cells(load_case(written(tmp_path / "case.toml", entry)))
        for entry in (cell, cell | {"pores": PORES})
    )
    lost = []
    for member in porous:
        void = member.law.youngs_modulus < 0.5 * member.law.youngs_modulus.max()
        middle = member.mesh.p[:, member.mesh.t].mean(axis=1)
        assert 0.01 < void.mean() < 0.12
        assert middle[2, void].max() < 1.02e-6
        lost.append(void)
    assert np.any(lost[0] != lost[1])
    gap = [
        solve_cell(item, Path(pressure=(1e8,)))["mean_gap"].values[0, 0]
        for item in (porous[0], solid[0])
    ]
    assert gap[0] < gap[1]


def test_a_pore_below_the_surface_makes_a_cell_softer(tmp_path):
    jump = []
    for name, pore in (("solid", False), ("pore", True)):
        write_voxels(tmp_path / f"{name}.msh", mushroom(pore=pore))
        path = written(
            tmp_path / f"{name}.toml", of_file(f"{name}.msh"), rough=False, realisations=1
        )
        (cell,) = make_cells(load_case(path))
        jump.append(solve_cell(cell, Path(pressure=(1e8,)))["mean_gap"].values[0, 0])
    assert jump[1] < jump[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        pytest.param({"contact_face": "skin"}, r"no face named 'skin'; its named", id="face"),
        pytest.param({"element": "tet4"}, r"has hexahedra, which an element 'tet4'", id="element"),
        pytest.param({"size": ["2 um", "1 um"]}, r"measures 1e-06 m x 1e-06 m", id="size"),
        pytest.param(
            {"volumes": {"core": {"youngs_modulus": "1 GPa", "poissons_ratio": "0.3"}}},
            r"no volume named core; its named volumes are none",
            id="volume",
        ),
        pytest.param(
            NO_FILE | {"pores": PORES | {"cover": "0.9 um"}}, "no pore .* fits whole", id="cover"
        ),
    ],
)
def test_what_does_not_fit_a_mesh_is_a_sentence(tmp_path, change, message):
    write_voxels(tmp_path / "rve.msh", mushroom())
    cell = {k: v for k, v in (of_file("rve.msh") | change).items() if v is not None}
    rough = cell.get("mesh") is None
    path = written(tmp_path / "case.toml", cell, rough=rough, realisations=1)
    with pytest.raises(CaseError, match=message):
        make_cells(load_case(path))


def test_named_volumes_need_laws_and_meshes_need_one_realisation(tmp_path):
    filled = mushroom()
    write_voxels(tmp_path / "rve.msh", filled, np.zeros(filled.shape, dtype=int))
    path = written(tmp_path / "case.toml", of_file("rve.msh"), rough=False, realisations=1)
    with pytest.raises(CaseError, match=r"names volumes without a law, matrix; give each"):
        make_cells(load_case(path))
    path = written(tmp_path / "case.toml", of_file("rve.msh"), rough=False, realisations=3)
    with pytest.raises(CaseError, match="has 3 realisations; set realisations = 1"):
        load_case(path)


def test_inverted_elements_are_counted_and_placed(tmp_path):
    def fold(points):  # lift one inner node of the bottom layer through the next node
        points = points.copy()
        inner = np.isclose(points, [0.5, 0.5, 0.125]).all(axis=1)
        points[inner, 2] = 0.6
        return points

    write_voxels(tmp_path / "rve.msh", mushroom(), move=fold)
    path = written(tmp_path / "case.toml", of_file("rve.msh"), rough=False, realisations=1)
    with pytest.raises(
        CaseError, match=r"[48] of \d+ elements have no volume or are turned inside out"
    ):
        make_cells(load_case(path))


def test_a_hard_body_makes_a_mesh_flow_and_unload(tmp_path):
    hard = {"youngs_modulus": "200 GPa", "poissons_ratio": "0.3", "hardness": "3 GPa"}
    micro = {"realisations": 1, "pressures": ["50 MPa", "100 MPa", "200 MPa"], "unload": True}
    path = written(tmp_path / "case.toml", elastic=False, body_2=hard, micro=micro)
    case = load_case(path)
    needs = requirements(case)
    assert "accumulated plastic strain" in needs.state_variables
    assert "Newton's matrix" in needs.built["factors"]
    (cell,) = make_cells(case)
    assert cell.law.yield_stress == case.yield_stress
    volumes = {"matrix": {"youngs_modulus": "200 GPa", "poissons_ratio": "0.3"}}
    file = of_file("rve.msh", volumes=volumes)
    path = written(tmp_path / "2.toml", file, elastic=False, body_2=hard, micro=micro, rough=False)
    with pytest.raises(CaseError, match=r"named volumes in \[cell\] are elastic"):
        load_case(path)


def test_needs_of_a_mesh_list_the_built_and_the_omitted_parts(tmp_path):
    needs = requirements(load_case(written(tmp_path / "case.toml")))
    assert "scikit-fem" in needs.libraries
    assert needs.built["stiffness"] == "assembled to a matrix"
    assert "layer factors" in needs.omitted


@pytest.mark.slow
def test_the_shipped_cell_on_quadratic_elements_is_close_to_the_conforming_kernel(tmp_path):
    case = load_case("mesh_cell").quick()
    micro = case.micro.model_copy(update={"realisations": 1})
    cells = {
        "mesh": case.cell,
        "conforming": case.cell.model_copy(update={"geometry": "conforming", "element": None}),
    }
    results = {}
    for name, cell in cells.items():
        changed = case.model_copy(update={"micro": micro, "cell": cell})
        path = Path(pressure=micro.pressures[::2])
        results[name] = run_ensemble(make_cells(changed), path, folder=tmp_path / name)
    for name, rtol in (("mean_gap", 0.03), ("contact_fraction", 0.15)):
        np.testing.assert_allclose(results["mesh"][name], results["conforming"][name], rtol=rtol)


@pytest.mark.slow
def test_the_shipped_cell_with_an_overhang_and_a_pore_touches_as_by_hertz(shipped_run):
    """Its summit is a sphere, on a stem that the contact does not reach."""
    response = open_dataset(shipped_run("overhang_cell")[0] / "micro_response.nc")
    pressure, area = response["nominal_pressure"].values, (20e-6) ** 2
    radius, modulus = 30e-6, 210e9 / (2.0 * (1.0 - 0.3**2))
    contact = (0.75 * pressure * area * radius / modulus) ** (1.0 / 3.0)
    share = np.pi * contact**2 / area
    np.testing.assert_allclose(response["contact_fraction"].values[0, 2:], share[2:], rtol=0.15)
