"""Requirements of a scene, printed before it is solved and equal to its use."""

import json
import os
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from multiscale.laws.link import Cable
from multiscale.macro import (
    cut_links,
    granulate,
    simulate,
    solve_latin,
    solve_static,
    tensegrity_grid,
)
from multiscale.macro.granulate import ContactLaw, Grains, Model, Solver, box
from multiscale.macro.granulate.grain_motion import initial_state, step_grains
from multiscale.macro.granulate.model import grain_needs
from multiscale.macro.links import dynamics as dynamics_module
from multiscale.macro.links.link_equations import Tangent
from multiscale.macro.links.link_system import link_needs
from multiscale.macro.substructures import latin as latin_module
from multiscale.macro.substructures import latin_solver as solve_module
from multiscale.macro.substructures import split_grid
from multiscale.macro.substructures.methods import cut_needs
from multiscale.pipeline import load_case, requirements
from tests.link_structures import truss
from tests.support import joints_of, run_python, write_law

SCENES = sorted((Path(__file__).parents[2] / "workflows" / "scenes").glob("*.toml"))

GRID = {
    "structure": {"kind": "tensegrity_grid", "n": 4, "prestress": "160 N"},
    "statics": {"load_factors": [0.0, 1.0]},
}
MOTION = {
    "structure": GRID["structure"],
    "dynamics": {
        "step": "5 ms",
        "duration": "25 ms",
        "mass": "2 kg",
        "load_history": [["0 s", 1.0]],
    },
}
PLATE = {
    "structure": {
        "kind": "plate",
        "size": ["4 m", "4 m", "0.2 m"],
        "elements": [4, 4, 1],
        "youngs_modulus": "70 GPa",
        "poissons_ratio": 0.3,
        "pressure": "1 kPa",
    },
    "substructures": {"parts": [2, 2]},
    "statics": {"load_factors": [1.0]},
}
DEPOSIT = {
    "structure": {"kind": "deposit", "size": ["10 cm", "10 cm"]},
    "grains": {"number": 30, "radius": ["4 mm", "6 mm"], "compliance": 0.05},
    "motion": {"step": "1 ms", "duration": "60 ms"},
}


SMOOTH = DEPOSIT | {"grains": DEPOSIT["grains"] | {"friction": 0.0}}


def larger(scene, **structure):
    return scene | {"structure": scene["structure"] | structure}


EQUIVALENT = {
    "structure": {"kind": "equivalent_plate", "links": GRID["structure"], "elements": [4, 4]},
    "statics": {"load_factors": [0.0, 1.0]},
}
LARGE = {
    "equivalent plate": larger(EQUIVALENT, elements=[24, 24]),
    "grid": larger(GRID, n=40, prestress="16 kN"),
    "motion": larger(MOTION, n=30, prestress="9 kN"),
    "plate": larger(PLATE, elements=[32, 32, 2]) | {"substructures": {"parts": [4, 4]}},
    "deposit": DEPOSIT | {"grains": DEPOSIT["grains"] | {"number": 2000}},
    "smooth grains": SMOOTH | {"grains": SMOOTH["grains"] | {"number": 2000}},
}
SMALL = {
    "equivalent plate": EQUIVALENT,
    "grid": GRID,
    "motion": MOTION,
    "plate": PLATE,
    "deposit": DEPOSIT,
    "smooth grains": SMOOTH,
}


def write(scene, file):
    import tomli_w

    file.write_text(tomli_w.dumps({"title": "one scene"} | scene), encoding="utf-8")
    return file


def run(code, *arguments):
    environment = dict(os.environ, OMP_NUM_THREADS="1")
    done = run_python(code, *arguments, env=environment)
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.parametrize("file", SCENES, ids=lambda file: file.stem)
def test_every_shipped_scene_lists_its_needs_and_the_omitted_parts(file):
    needs = requirements(load_case(file))
    assert needs.built
    assert needs.omitted
    assert all(choice.why for choice in needs.choices)
    assert not set(needs.built) & set(needs.omitted)


@pytest.mark.parametrize(
    "name",
    [
        "grid",
        *(
            pytest.param(entry, marks=pytest.mark.slow)
            for entry in ("deposit", "motion", "plate", "smooth grains")
        ),
    ],
)
def test_a_scene_imports_the_libraries_it_names_and_no_other(name, tmp_path):
    code = """
        import json, sys
        from pathlib import Path
        from multiscale.pipeline import load_case, run_macro
        run_macro(load_case(sys.argv[1]), Path(sys.argv[1]).with_name("out.nc"))
        print(json.dumps([name.split(".")[0] for name in sys.modules]))
        """
    file = write(SMALL[name], tmp_path / "scene.toml")
    loaded = set(run(code, file))
    heavy = {  # without dask, which xarray loads by itself where it finds it
        "numba": "numba",
        "skfem": "scikit-fem",
        "meshio": "meshio",
        "gmsh": "gmsh",
        "pypardiso": "pypardiso",
        "clarabel": "clarabel",
        "matplotlib": "matplotlib",
        "mpi4py": "mpi4py",
        "SurfaceTopography": "SurfaceTopography",
    }
    results = {heavy[module] for module in loaded & set(heavy)}
    assert results == set(requirements(load_case(file)).libraries)


@pytest.mark.slow
@pytest.mark.parametrize("name", LARGE)
def test_the_stated_memory_is_the_memory_taken_within_a_factor_of_two(name, tmp_path):
    code = """
        import json, sys
        from multiscale.bench.measure import peak_memory
        from multiscale.pipeline import load_case, run_macro
        small, large, out = sys.argv[1:]
        peaks = []
        for scene in (small, large):  # the first brings libraries and compiled kernels
            run_macro(load_case(scene), out)
            peaks.append(peak_memory())
        print(json.dumps(peaks))
        """
    small = write(SMALL[name], tmp_path / "small.toml")
    large = write(LARGE[name], tmp_path / "large.toml")
    before, after = run(code, small, large, tmp_path / "out.nc")
    text = requirements(load_case(large)).memory
    assert 0.5 <= text / (after - before) <= 2.0, (text, after - before)


def test_a_scene_lists_the_needs_of_its_options():
    grid = tensegrity_grid(2)
    plain, exact = link_needs(grid), link_needs(grid, exact=True)
    assert set(plain.built) == {"tangent", "slack"}
    assert set(exact.built) == {
        "tangent",
        "slack",
        "moved positions",
        "geometric stiffness",
    }
    stable = link_needs(grid, stability=True)
    assert set(stable.built) - set(plain.built) == {
        "geometric stiffness",
        "eigenvalues",
    }
    moving = link_needs(grid, moving=True)
    assert set(moving.built) - set(plain.built) == {"mass"}
    assert moving.state_variables
    assert plain.unknowns_per_contact == 1


def test_a_cut_lists_the_needs_of_its_interfaces():
    whole = cut_needs(3000)
    assert set(whole.built) == {"substructure stiffness", "error bound"}
    assert set(cut_needs(3000, substructures=4).built) - set(whole.built) == {"coarse problem"}
    rough = cut_needs(3000, joint_points=100)
    assert rough.unknowns_per_contact == 3
    assert "error indicator" in rough.built
    assert "error bound" in rough.omitted
    assert "coarse problem" in cut_needs(3000, substructures=4, coarse=False).omitted


def test_a_joint_without_cycles_has_fewer_slabs_and_states_it(tmp_path):
    (path,) = (file for file in SCENES if file.stem == "rough_blocks")
    cycled = load_case(path)
    pressed = cycled.model_copy(update={"cycles": None})
    law = write_law(tmp_path / "law.nc")
    for scene, slabs in ((cycled, 48), (pressed, 8)):
        assert f"; {slabs} slabs of sliders" in requirements(scene).built["joint laws"]
        bodies, laws = joints_of(scene.from_structure(law))
        (bed,) = bodies.sliders(scene, laws)
        assert bed.slabs == slabs
        assert bed.pressures == (0.2e6, 60e6)


def test_grains_list_the_needs_of_their_law_and_their_solver():
    plain = grain_needs(100, 2, ContactLaw(friction=0.0), Solver(most_assembled=0))
    assert set(plain.built) == {"sweeps"}
    full = grain_needs(100, 2, ContactLaw(0.5, 0.1, 0.05), Solver())
    assert set(full.built) - set(plain.built) == {
        "friction",
        "rotation",
        "springs",
        "restitution",
        "assembled problem",
    }


def test_a_cell_that_strains_has_no_assembled_problem():
    needs = grain_needs(100, 2, ContactLaw(), Solver(), strained=True)
    assert {"cell strain", "sweeps", "friction", "rotation"} == set(needs.built)
    biaxial = requirements(load_case(SCENES[0].parent / "biaxial.toml"))
    assert "cell strain" in biaxial.built


@pytest.mark.parametrize(
    ("law", "changes", "unknowns", "turns"),
    [
        pytest.param(ContactLaw(0.0), {}, 1, False, id="smooth"),
        pytest.param(ContactLaw(0.5), {}, 3, True, id="rough"),
        pytest.param(ContactLaw(0.0), {"wall_friction": 0.3}, 3, True, id="rough wall"),
        pytest.param(ContactLaw(0.0), {"spin": 1.0}, 1, True, id="smooth and spinning"),
    ],
)
def test_grains_take_the_unknowns_and_the_spins_that_they_need(law, changes, unknowns, turns):
    spin = np.full((8, 3), changes.get("spin", 0.0))
    places = np.stack(np.meshgrid(*[[0.0101, 0.0303]] * 3), axis=-1).reshape(-1, 3)
    walls = box((0, 0, 0), (0.0404, 0.0404, np.inf), friction=changes.get("wall_friction"))
    model = Model(Grains(places, 0.01, spin=spin), walls, law)
    assert model.frictional == (unknowns == 3)
    assert model.turns == turns
    state, step = step_grains(model, initial_state(model), 5e-3, Solver())
    assert step["n_contacts"] > 0
    contacts = state.contacts
    assert {contacts.impulse.shape[1], contacts.anchor.shape[1]} == {unknowns}
    assert (contacts.coulomb is None) == (unknowns == 1)
    assert {state.velocity.shape[1], model.free_acceleration.shape[1]} == {8 if turns else 4}
    assert model.mobility.shape[1] == (3 if turns else 1)
    motion = granulate.simulate_grains(model, 0.02, 5e-3)
    assert ("spin" in motion) == turns
    if unknowns == 1 and turns:
        np.testing.assert_allclose(motion["spin"].values[-1], spin, rtol=1e-12)


def test_a_step_without_friction_holds_less_memory():
    fixed = []
    places = np.stack(np.meshgrid(*[np.arange(10)] * 3), axis=-1).reshape(-1, 3)
    for friction in (0.0, 0.5, 0.0, 0.5):  # the first two import and compile
        walls = box((0, 0, 0), (0.202, 0.202, np.inf))
        model = Model(Grains((2.02 * places + 1.01) * 0.01, 0.01), walls, ContactLaw(friction))
        state = initial_state(model)
        sweeps = Solver(max_iterations=10, most_assembled=0)
        state, _ = step_grains(model, state, 2e-3, sweeps)
        tracemalloc.start()
        state, _ = step_grains(model, state, 2e-3, sweeps)
        fixed.append(tracemalloc.get_traced_memory()[0])  # the search for contacts has the peak
        tracemalloc.stop()
    assert fixed[2] < 0.75 * fixed[3]


def count(monkeypatch, owner, name):
    """Count calls of a function."""
    calls, function = [], getattr(owner, name)

    def counted(*arguments, **options):
        calls.append(name)
        return function(*arguments, **options)

    monkeypatch.setattr(owner, name, counted)
    return calls


def test_bars_that_cannot_go_slack_take_one_factorisation(monkeypatch):
    structure = truss(4)
    assert "slack" in link_needs(structure).omitted
    factors = count(monkeypatch, Tangent, "factorise")
    assert solve_static(structure, [1.0]).converged.values.all()
    assert len(factors) == 1


@pytest.mark.parametrize(
    "options", [{}, {"exact": True}, {"stability": True}], ids=["plain", "exact", "stability"]
)
def test_geometric_stiffness_is_built_where_it_is_needed_and_nowhere_else(monkeypatch, options):
    grid = tensegrity_grid(3, prestress=100.0)
    built = count(monkeypatch, Tangent, "geometric")
    assert solve_static(grid, 1.0, **options).converged.values.all()
    assert bool(built) == ("geometric stiffness" in link_needs(grid, **options).built)


@pytest.mark.parametrize("rigid", [False, True])
def test_impulses_are_sought_where_a_link_has_a_fixed_length(monkeypatch, rigid):
    """Complementarity is solved once in each Newton iteration of each step, or in none."""
    grid = tensegrity_grid(2, prestress=40.0, **({"cable": Cable(np.inf)} if rigid else {}))
    sought, steps = count(monkeypatch, dynamics_module, "solve_lcp"), []
    solve_step = dynamics_module.limited_motion

    def counted(*arguments):
        before, computed = len(sought), solve_step(*arguments)
        steps.append((len(sought) - before, len(computed.residuals)))
        return computed

    monkeypatch.setattr(dynamics_module, "limited_motion", counted)
    simulate(grid, np.array([0.0, 1e-3, 2e-3]), 2.0)
    assert len(steps) == 2
    for problems, iterations in steps:
        assert problems == (iterations if rigid else 0)
    assert ("impulses" in link_needs(grid, moving=True).built) is rigid


@pytest.mark.parametrize("coarse", [False, True])
def test_a_coarse_problem_and_a_bound_are_built_where_they_are_wanted(monkeypatch, coarse):
    grid = tensegrity_grid(4, prestress=160.0)
    problem = cut_links(grid, split_grid(grid, (2, 2)))
    prepared = count(monkeypatch, latin_module, "prepare_coarse")
    bounds = count(monkeypatch, solve_module, "ErrorEstimate")
    solve_latin(problem, 0.5, coarse=coarse, tolerance=1e-3)
    needs = cut_needs(problem.n, links=problem.n_links, substructures=4, coarse=coarse)
    assert bool(prepared) == ("coarse problem" in needs.built) == coarse
    assert bool(bounds) == ("error bound" in needs.built) == coarse


def test_more_load_factors_take_more_memory(tmp_path):
    scene = load_case(write(GRID, tmp_path / "scene.toml"))
    first, more, most = (
        requirements(
            scene.model_copy(
                update={
                    "statics": scene.statics.model_copy(update={"load_factors": (0.0,) * count})
                }
            )
        )
        for count in (1, 10, 19)
    )
    system = scene.structure.build()
    fields = system.n_links + np.count_nonzero(~system.fixed)  # tension and displacement
    assert more.memory - first.memory == most.memory - more.memory > 9 * 8 * fields
    same = {"memory": 0, "costs": (), "seconds": 0.0}
    assert replace(more, **same) == replace(first, **same)
