"""Structures of links that several tests need, and an independent solver of their statics."""

from dataclasses import replace

import numpy as np
from scipy.sparse import csc_array, diags_array, vstack

from multiscale.laws.link import Bar, Beam
from multiscale.macro import LinkSystem, tensegrity_grid
from multiscale.macro.links.link_equations import equations
from multiscale.nonsmooth.refusals import solve_conic


def structure(position, ends, *laws, held, kind=None, load=None, **options):
    """Links between points; ``held`` has fixed components by node, ``load`` forces by node."""
    position, ends = np.array(position, dtype=float), np.array(ends)
    shape = (len(position), 6 if any(isinstance(law, Beam) for law in laws) else 3)
    fixed, force = np.zeros(shape, dtype=bool), np.zeros(shape)
    for node, components in held.items():
        fixed[node, components] = True
    for node, values in (load or {}).items():
        force[node, : len(values)] = values
    kind = np.zeros(len(ends), dtype=int) if kind is None else np.array(kind)
    return LinkSystem(position, ends, laws, kind, fixed, force, **options)


def free_module(**options):
    """Quadruplex module without supports and load."""
    module = tensegrity_grid(1, **options)
    return replace(module, fixed=np.zeros((8, 3), dtype=bool), load=np.zeros((8, 3)))


def truss(panels):
    """Simply supported plane Pratt truss of 1 m by 1 m panels, 1 kN at every lower inner node.

    Links: lower chord, upper chord, posts, diagonals that descend towards the middle, end bars.
    """
    inner, half = np.arange(1, panels), panels // 2
    upper = panels + inner  # upper node above lower node i is panels + i
    left, right = inner[inner < half], inner[inner > half]
    chain = np.arange(panels)
    ends = [[chain, chain + 1], [upper[:-1], upper[1:]], [inner, upper]]
    ends += [[panels + left, left + 1], [panels + right, right - 1]]
    ends += [[[0, panels], [panels + 1, 2 * panels - 1]]]
    ends = np.concatenate([np.stack(pair, axis=1) for pair in ends])
    position, load = np.zeros((2, 2 * panels, 3))
    position[: panels + 1, 0] = np.arange(panels + 1)
    position[panels + 1 :, 0] = inner
    position[panels + 1 :, 2] = 1.0
    load[1:panels, 2] = -1000.0
    fixed = np.zeros((2 * panels, 3), dtype=bool)
    fixed[:, 1] = True
    fixed[0] = True
    fixed[panels, 2] = True
    return LinkSystem(position, ends, (Bar(2.1e8),), np.zeros(len(ends), dtype=int), fixed, load)


def solve_dual_program(system, load_factor):
    r"""Return tensions of least complementary energy in equilibrium with the load, by clarabel.

    .. math::
        \min_\tau \sum \frac{(\tau - \tau^0)^2}{2 k}, \qquad
        B^T \tau = \alpha F^d, \quad \tau^- \le \tau \le \tau^+.

    The multipliers of the equilibrium are the displacement, with the opposite sign. Links of
    fixed length have no term. Returns the status of clarabel, the tensions, N, the displacement of
    the nodes and the slacks, m. Tensions are accurate to about 1e-7.
    """
    model = equations(system)
    load = load_factor * model.load
    scale = np.abs(load).max(initial=0.0) + np.abs(model.prestress).max() or 1.0
    finite = np.isfinite(model.stiffness)
    unit = np.median(model.stiffness[finite])
    give = unit / model.stiffness
    rope, prop = np.isfinite(model.lower), np.isfinite(model.upper)
    identity = csc_array(diags_array(np.ones(give.size)))
    constraints = vstack([csc_array(model.operator.T), -identity[rope], identity[prop]])
    bounds = np.concatenate([load, -model.lower[rope], model.upper[prop]]) / scale
    for tolerance in (1e-13, 1e-12, 1e-11, 1e-10):  # until it is met
        answer = solve_conic(
            diags_array(give),
            -give * model.prestress / scale,
            constraints,
            bounds,
            zero=model.n,
            positive=bounds.size - model.n,
            tolerance=tolerance,
        )
        status = str(answer.status)
        if status in ("Solved", "PrimalInfeasible"):
            break
    tension = np.clip(scale * np.array(answer.x), model.lower, model.upper)
    u = -scale / unit * np.array(answer.z)[: model.n]
    misfit = np.abs((tension - model.prestress) / model.stiffness - model.elongate(u))
    # tension or slack is zero: the smaller of the two is rounding
    slack = np.where((rope | prop) & (misfit > np.abs(tension) / unit), misfit, 0.0)
    return status, tension, model.at_nodes(u), slack
