"""Statics of links: methods against each other and against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from multiscale.laws.link import Bar, Beam, Cable, Strut
from multiscale.macro import cable_net, solve_static, tensegrity_grid
from multiscale.macro.links import link_newton
from multiscale.macro.links.link_equations import Tangent, compatibility, equations
from multiscale.macro.links.link_newton import unbalanced_zones
from multiscale.macro.links.mechanisms import name_motion
from multiscale.numerics.newton import Limits
from tests.link_structures import solve_dual_program, structure

ALL = slice(None)


def chain(links):
    """Ends of links one after the other."""
    return np.stack([np.arange(links), np.arange(1, links + 1)], axis=1)


def equilibrium_error(system, result, load_factor):
    """Largest force out of balance relative to the largest load."""
    load = load_factor * system.load[~system.fixed]
    unbalanced = compatibility(system).T @ result.tension.values - load
    return np.abs(unbalanced).max() / (np.abs(load).max() or np.abs(system.prestress).max())


# --- methods ---------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["newton", "interior_point", "lcp"])
def test_all_methods_find_the_tensions_of_the_dual_program(method):
    grid = tensegrity_grid(5, 4, prestress=300.0)
    status, tension, _, slack = solve_dual_program(grid, 1.0)
    assert status == "Solved"
    result = solve_static(grid, 1.0, method=method)
    assert result.converged == 1
    assert 0 < np.count_nonzero(slack) == np.count_nonzero(result.slack)
    np.testing.assert_allclose(result.tension, tension, atol=1e-7 * np.abs(tension).max())
    np.testing.assert_allclose(result.slack, slack, atol=1e-7)


@pytest.mark.parametrize("load_factor", [0.5, 1.0, 4.0])
def test_factors_without_slack_that_are_stored_lead_to_the_same_tensions(load_factor, monkeypatch):
    grid = tensegrity_grid(16)
    reference = solve_static(grid, load_factor, method="newton")
    made, factorise = [], Tangent.factorise
    monkeypatch.setattr(
        Tangent, "factorise", lambda *args, **key: made.append(1) or factorise(*args, **key)
    )
    monkeypatch.setattr(link_newton, "LARGE", 0)
    result = solve_static(grid, load_factor, method="newton")
    assert result.converged == 1
    assert load_factor == 4.0 or 1 < len(made) <= 3, "one or two beside those without slack"
    assert equilibrium_error(grid, result, load_factor) < 1e-9
    largest = float(np.abs(reference.tension).max())
    np.testing.assert_allclose(result.tension, reference.tension, atol=1e-9 * largest)


def test_zones_solved_separately_save_factorisations_of_the_whole(monkeypatch):
    grid, sizes, factorise = tensegrity_grid(16), [], Tangent.factorise

    def count(tangent, entries, **options):
        sizes.append(tangent.diagonal.size)
        return factorise(tangent, entries, **options)

    monkeypatch.setattr(Tangent, "factorise", count)
    whole = []
    for large in (10**9, 0):
        monkeypatch.setattr(link_newton, "LARGE", large)
        sizes.clear()
        assert solve_static(grid, 4.0, method="newton").converged == 1
        whole.append(sizes.count(max(sizes)))
    assert min(sizes) < 0.1 * max(sizes)
    assert whole[1] <= 0.75 * whole[0], "8 and 12"


def test_zones_out_of_balance_are_apart_and_balanced_by_separate_equations():
    grid = tensegrity_grid(24)
    model = equations(grid)
    load = np.zeros(model.n)
    load[model.number[[30, 550], 2]] = -1e4  # two nodes of the lower layer, far apart
    u = np.random.default_rng(seed=5).uniform(-1e-7, 1e-7, model.n)
    elastic = model.stiffness * model.elongate(u)
    parts = list(unbalanced_zones(model, load, elastic))
    for unknowns, part, largest in parts:
        assert largest == pytest.approx(1e4, rel=0.01)
        nothing = np.zeros(unknowns.size)
        state = link_newton.solve_newton(part, 1.0, nothing, Limits())
        assert state.solution.converged
        u[unknowns] += state.solution.value
    assert len(parts) == 2
    tension = np.clip(
        model.prestress + model.stiffness * model.elongate(u), model.lower, model.upper
    )
    residual = np.abs(load - model.gather(tension))
    inside = np.concatenate([unknowns for unknowns, *_ in parts])
    assert inside.size == np.unique(inside).size <= 0.1 * model.n
    assert residual[inside].max() < 1e-9 * 1e4
    assert residual.max() > 1.0, "the rest was held"


def test_the_corrected_solution_is_symmetric_and_meets_the_last_step():
    rng = np.random.default_rng(seed=3)
    root = rng.standard_normal((6, 6))
    stiffness = root @ root.T + np.eye(6)
    pairs = [(step, stiffness @ step) for step in rng.standard_normal((3, 6))]
    flexibility = np.array(
        [link_newton.secant_direction(lambda force: 0.1 * force, pairs, e) for e in np.eye(6)]
    )
    np.testing.assert_allclose(flexibility, flexibility.T, atol=1e-12)
    np.testing.assert_allclose(flexibility @ pairs[-1][1], pairs[-1][0], atol=1e-12)
    assert np.linalg.eigvalsh(flexibility)[0] > 0.0


def test_a_step_that_does_not_converge_is_nan_with_a_reason():
    grid = tensegrity_grid(8, prestress=300.0)
    result = solve_static(grid, [0.0, 10.0], max_iterations=3)
    np.testing.assert_array_equal(result.converged, [1, 0])
    for name in ("tension", "slack", "displacement"):
        assert np.isfinite(result[name].sel(step=0)).all()
        assert np.isnan(result[name].sel(step=1)).all()
    assert result.failure.startswith("load factor 10: ")
    assert "raise max_iterations" in result.failure


def test_an_interior_point_takes_over_where_newton_gives_up(monkeypatch):
    grid = tensegrity_grid(8, prestress=300.0)
    reference = solve_static(grid, 10.0)
    monkeypatch.setattr(link_newton, "MAX_SHORT_STEPS", 1)
    assert solve_static(grid, 10.0, method="newton").converged == 0
    result = solve_static(grid, 10.0)
    assert result.converged == 1
    largest = float(np.abs(reference.tension).max())
    np.testing.assert_allclose(result.tension, reference.tension, atol=1e-9 * largest)


def test_a_sweep_starts_warm_and_ends_where_a_single_step_does():
    grid = tensegrity_grid(6)
    factors = [0.0, 0.5, 1.0, 1.5, 1.0]
    sweep = solve_static(grid, factors)
    for step, factor in enumerate(factors):
        single = solve_static(grid, factor)
        np.testing.assert_allclose(
            sweep.tension.sel(step=step), single.tension, rtol=1e-8, atol=1e-6
        )
    assert int(sweep.iterations[4]) <= int(solve_static(grid, 1.0).iterations)


def test_an_inextensible_cable_keeps_its_length():
    grid = tensegrity_grid(4, cable=Cable(np.inf), prestress=500.0)
    result = solve_static(grid, 2.0)
    assert result.converged == 1
    status, tension, *_ = solve_dual_program(grid, 2.0)
    assert status == "Solved"
    bars = grid.kind == 1  # their tensions are unique
    largest = np.abs(tension[bars]).max()
    np.testing.assert_allclose(result.tension[bars], tension[bars], atol=1e-7 * largest)
    assert equilibrium_error(grid, result, 2.0) < 1e-8
    elongation = compatibility(grid) @ result.displacement.values[~grid.fixed]
    size = float(np.abs(result.displacement).max())
    cables = grid.kind == 0
    np.testing.assert_allclose(elongation[cables], -result.slack.values[cables], atol=1e-8 * size)
    assert np.any(result.slack > 0.0)


# --- stiff and extreme -----------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [1.0, 1e2, 1e4, 1e6])
def test_any_ratio_of_bar_to_cable_stiffness_ends_at_round_off(ratio):
    grid = tensegrity_grid(8, bar=Bar(4e6 * ratio), prestress=600.0)
    result = solve_static(grid, [0.5, 1.0, 4.0, 1000.0])
    assert np.all(result.converged == 1)
    assert np.all(result.residual < 1e-10)


@pytest.mark.parametrize("share", [0.0, 1e-6, 1e-3, 1.0, 1e3])
def test_any_prestress_ends_at_round_off(share):
    result = solve_static(tensegrity_grid(8, prestress=2550.0 * share), [0.0, 1.0, 1000.0])
    assert np.all(result.converged == 1)
    assert np.all(result.residual < 1e-9)


def without(system, link):
    """Cut a link; the others keep their relaxed lengths, so the prestress is not balanced."""
    stored = np.delete(np.arange(system.n_links), link)
    shorter = {
        name: getattr(system, name)[stored] for name in ("ends", "kind", "prestress", "group")
    }
    return replace(system, **shorter, balanced=False)


def test_a_cut_cable_is_carried_or_the_free_nodes_are_named():
    grid = tensegrity_grid(8)
    spare = solve_static(without(grid, 0), [0.0, 1.0])  # a lower cable on the edge
    assert np.all(spare.converged == 1)
    for load_factor in (0.1, 1.0, 100.0):
        cut = without(grid, 36)  # an upper cable inside
        broken = solve_static(cut, load_factor)
        assert broken.converged == 0
        assert np.isnan(broken.tension).all()
        status, _, motion, _ = solve_dual_program(cut, load_factor)
        assert status == "PrimalInfeasible"
        named = broken.failure.split(" can move")[0].split(": ")[1]
        assert name_motion(equations(cut), motion[~cut.fixed]).startswith(f"{named} can move")
        node = int(named.removeprefix("node "))
        assert node in cut.ends[grid.group[:-1] == grid.group[36]]
        assert "without resistance, and the load acts on this motion" in broken.failure


def test_a_mechanism_is_refused_with_the_node_that_moves():
    # two bars in line do not hold their joint across; prestress would, in its moved position
    line = structure(
        [[0, 0, 0], [1, 0, 0], [2, 0, 0]],
        [[0, 1], [1, 2]],
        Bar(1e6),
        held={0: ALL, 2: ALL},
        load={1: (0.0, 0.0, -10.0)},
        prestress=np.array([1e3, 1e3]),
    )
    result = solve_static(line, [0.0, 1.0])
    assert np.all(result.converged == 0)
    assert "node 1 can move without resistance; an exact analysis (exact" in result.failure

    moved = solve_static(line, exact=True)
    w = -float(moved.displacement.sel(node=1, component="z"))
    length = np.hypot(1.0, w)
    tension = 1e3 + 1e6 * (length - 1.0)
    assert moved.converged == 1
    assert 2.0 * tension * w / length == pytest.approx(10.0, rel=1e-10)


def test_no_load_moves_nothing_and_a_vanishing_load_little():
    result = solve_static(tensegrity_grid(4), [0.0, 1e-9])
    assert not np.any(result.displacement.sel(step=0))
    linear = solve_static(tensegrity_grid(4), 1e-3).displacement / 1e-3
    np.testing.assert_allclose(
        result.displacement.sel(step=1) / 1e-9, linear, atol=1e-4 * float(np.abs(linear).max())
    )


# --- frames ----------------------------------------------------------------------------------


def portal(bending_column=2e6, bending_beam=5e6, height=4.0, span=6.0):
    """Portal frame with fixed feet, 1 kN sideways at the top; nearly inextensible."""
    columns = Beam(1e13, 1e6, bending_column, bending_column)
    beam = Beam(1e13, 1e6, bending_beam, bending_beam)
    return structure(
        [[0, 0, 0], [0, 0, height], [span, 0, height], [span, 0, 0]],
        [[0, 1], [1, 2], [3, 2]],
        columns,
        beam,
        kind=[0, 1, 0],
        held={0: ALL, 3: ALL},
        load={1: (500.0,), 2: (500.0,)},
    )


def test_a_portal_frame_sways_by_the_slope_deflection_method():
    h, k = 4.0, (5e6 / 2e6) * (4.0 / 6.0)
    result = solve_static(portal())
    sway = 1e3 * h**3 / (12.0 * 2e6) * (3 * k + 2) / (6 * k + 1)
    assert float(result.displacement.sel(node=1, component="x")) == pytest.approx(sway, rel=1e-6)
    foot = 1e3 * h / 2 * (3 * k + 1) / (6 * k + 1)
    corner = 1e3 * h / 2 * (3 * k) / (6 * k + 1)
    moment = np.abs(result.moment.sel(link=0))
    assert float(moment.sel(part=["y1", "z1"]).max()) == pytest.approx(foot, rel=1e-6)
    assert float(moment.sel(part=["y2", "z2"]).max()) == pytest.approx(corner, rel=1e-6)
    # the shear of the beam holds the columns down: both corners' moments over the span
    assert float(result.tension.sel(link=0)) == pytest.approx(2 * corner / 6.0, rel=1e-6)


def test_a_brace_takes_load_from_the_frame_while_it_is_taut():
    frame = portal()
    brace = np.array([[0, 2], [3, 1]])
    braced = replace(
        frame,
        ends=np.vstack([frame.ends, brace]),
        laws=(*frame.laws, Cable(1e7)),
        kind=np.append(frame.kind, [2, 2]),
        prestress=np.zeros(5),
        group=np.zeros(5, dtype=int),
    )
    result = solve_static(braced)
    free = solve_static(frame)
    assert float(result.tension.sel(link=3)) > 0.0
    assert float(result.tension.sel(link=4)) == 0.0 < float(result.slack.sel(link=4))
    sway = [float(r.displacement.sel(node=1, component="x")) for r in (result, free)]
    assert sway[0] < 0.5 * sway[1]
    assert np.isnan(result.moment.sel(link=3)).all()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_cantilever_in_any_direction_bends_shears_and_twists(seed):
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    x, z = axes[0], axes[2]
    y = np.cross(z, x)
    length, shear_y, shear_z = 1.7, 3e5, 4e5
    beam = Beam(1e7, 2e4, 5e4, 3e4, shear_y, shear_z, up=tuple(z + 0.3 * x))
    load = np.append(11.0 * x + 20.0 * y + 30.0 * z, 7.0 * x)
    system = structure([0.0 * x, length * x], [[0, 1]], beam, held={0: ALL}, load={1: load})
    result = solve_static(system)
    u = result.displacement.sel(node=1).values
    turn = result.rotation.sel(node=1).values
    assert u @ x == pytest.approx(11.0 * length / 1e7)
    assert u @ y == pytest.approx(20.0 * (length**3 / (3 * 3e4) + length / shear_y))
    assert u @ z == pytest.approx(30.0 * (length**3 / (3 * 5e4) + length / shear_z))
    assert turn @ x == pytest.approx(7.0 * length / 2e4)
    assert turn @ z == pytest.approx(20.0 * length**2 / (2 * 3e4))
    assert turn @ y == pytest.approx(-30.0 * length**2 / (2 * 5e4))
    moment = result.moment.sel(link=0)
    assert float(np.abs(moment.sel(part="z1"))) == pytest.approx(20.0 * length)
    assert float(np.abs(moment.sel(part="y1"))) == pytest.approx(30.0 * length)
    assert float(moment.sel(part="torsion")) == pytest.approx(7.0)
    np.testing.assert_allclose(moment.sel(part=["y2", "z2"]), 0.0, atol=1e-9)


# --- stability -------------------------------------------------------------------------------


def column(pieces):
    """Cantilever under a unit axial load."""
    height = np.linspace(0.0, 2.0, pieces + 1)
    position = np.stack([0.0 * height, 0.0 * height, height], axis=1)
    law, tip = Beam(1e8, 1e4, 1e4, 1e4), (0.0, 0.0, -1.0)
    return structure(position, chain(pieces), law, held={0: ALL}, load={pieces: tip})


def test_the_critical_factor_of_a_column_tends_to_eulers_load():
    euler = np.pi**2 * 1e4 / (4.0 * 2.0**2)

    def critical(pieces):
        """Factor at which the smallest eigenvalue of the tangent is zero."""

        def eigenvalue(factor):
            result = solve_static(column(pieces), [factor], stability=True)
            return float(result.stability_eigenvalue[0])

        return brentq(eigenvalue, 0.1 * euler, 2.0 * euler, rtol=1e-8)

    errors = [critical(pieces) / euler - 1.0 for pieces in (4, 8, 16)]
    assert errors[2] < 1e-3
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 4.0, rtol=0.05)


def test_two_bars_and_a_spring_buckle_at_half_spring_times_length():
    system = structure(
        [[0, 0, 0], [1.5, 0, 0], [3, 0, 0], [1.5, 1, 0]],
        [[0, 1], [1, 2], [3, 1]],
        Bar(1e9),
        Bar(400.0),
        kind=[0, 0, 1],
        held={0: ALL, 1: [2], 2: [1, 2], 3: ALL},
        load={2: (-1.0,)},
    )
    result = solve_static(system, [0.0, 100.0, 400.0], stability=True)
    np.testing.assert_allclose(result.tangent_eigenvalue, 400.0, rtol=1e-6)
    lost = 2.0 * result.load_factor / 1.5
    np.testing.assert_allclose(result.stability_eigenvalue, 400.0 - lost, rtol=1e-5)


# --- exact kinematics ------------------------------------------------------------------------


def test_exact_and_small_displacements_agree_under_small_loads():
    grid = tensegrity_grid(4)
    small, exact = solve_static(grid, 1e-3), solve_static(grid, 1e-3, exact=True)
    size = float(np.abs(small.displacement).max())
    # the geometric stiffness of the prestress, which small perturbations leave out, is 1 % here
    np.testing.assert_allclose(small.displacement, exact.displacement, atol=0.02 * size)
    heavy = solve_static(grid, 1e2, exact=True)
    assert heavy.converged == 1


def test_an_elastic_string_follows_its_closed_form():
    net = cable_net(2, rise=0.0, prestress=100.0, cable=Cable(1e5), nodal_load=1e4)
    result = solve_static(net, [0.1, 1.0], exact=True)
    middle = int(np.flatnonzero(~net.fixed.any(axis=1))[0])
    for step, load in enumerate((1e3, 1e4)):
        w = -float(result.displacement.sel(step=step, node=middle, component="z"))
        length = np.hypot(1.0, w)
        tension = 100.0 + 1e5 * (length - 1.0)
        assert 4.0 * tension * w / length == pytest.approx(load, rel=1e-9)


@pytest.mark.parametrize("links", [2, 3, 10, 50])
@pytest.mark.parametrize("strain", [1e-9, 1e-5, 1e-2], ids=["light", "heavy", "very-heavy"])
def test_a_nearly_straight_cable_sags_like_its_links(links, strain):
    """Sag 1 mm over 10 m, without prestress. Every link carries the same horizontal force H, and
    the vertical force of a link is the load beyond it.
    """
    span, rigidity = 10.0, 1e6
    x = np.linspace(0.0, span, links + 1)
    position = np.stack([x, 0.0 * x, -4e-3 * x * (span - x) / span**2], axis=1)
    weight = strain * rigidity / links
    fixed = {0: ALL, links: ALL} | {node: [1] for node in range(1, links)}
    load = dict.fromkeys(range(1, links), (0.0, 0.0, -weight))
    cable = structure(position, chain(links), Cable(rigidity), held=fixed, load=load)
    result = solve_static(cable, [0.5, 1.0], exact=True)
    assert np.all(result.converged == 1)
    length = np.linalg.norm(np.diff(position, axis=0), axis=1)
    vertical = weight * (np.arange(links) - 0.5 * (links - 1))

    def reach(horizontal):
        tension = np.hypot(horizontal, vertical)
        stretched = length * (1.0 + tension / rigidity)
        return float(np.sum(stretched * horizontal / tension)) - span

    horizontal = brentq(reach, 1e-9 * rigidity, rigidity, xtol=1e-12)
    expected = np.hypot(horizontal, vertical)
    np.testing.assert_allclose(result.tension.sel(step=1), expected, rtol=1e-6)


def test_a_prop_that_lifts_off_leaves_the_load_to_the_others():
    post = structure(
        [[0, 0, 1], [0, 0, 0], [0, 0, 2]],
        [[1, 0], [0, 2]],
        Strut(1e6),
        Bar(1e6),
        kind=[0, 1],
        held={0: [0, 1], 1: ALL, 2: ALL},
        load={0: (0.0, 0.0, 100.0)},
    )
    lifted = solve_static(post)
    np.testing.assert_allclose(lifted.tension, [0.0, -100.0])
    assert float(lifted.slack[0]) == pytest.approx(100.0 / 1e6)
    pressed = solve_static(post, -1.0)
    np.testing.assert_allclose(pressed.tension, [-50.0, 50.0])
