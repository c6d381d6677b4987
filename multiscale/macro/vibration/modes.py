r"""Modes of small vibration about a preload, of supported or free structures."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm
from scipy.linalg import eigh, qr
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import LinearOperator, eigsh

from multiscale.errors import CaseError
from multiscale.fe.elasticity import assemble_mass
from multiscale.fe.rigid_motion import free_motions, rigid_motions
from multiscale.macro.continuum.body import Body
from multiscale.macro.substructures.problem import CutProblem
from multiscale.numerics.factorisation import factorise, on_diagonal

FEW = 600  # unknowns up to which a dense solver computes all modes
MORE = 2  # modes computed beyond the last requested mode, to detect coinciding frequencies

COINCIDE = 1e-4
"""Distance of two frequencies, relative to them, up to which their shapes are not determined."""

RIGID = 0.5  # share of the mass of a mode in rigid motions from which it counts as rigid

NAMES = ("along x", "along y", "along z", "about x", "about y", "about z")


def find_free_motions(
    problem: CutProblem, stiffness: csr_array
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Determine the rigid motions of all bodies together that the stiffness does not resist.

    Returns the displacement of the unknowns in them, shape (n, motions), m; as many unknowns that
    constrain only these motions if they are fixed, so that loads in equilibrium have no reaction
    there; and names such as ``"along x"`` and ``"about z"``.
    """
    rigid = rigid_motions(*problem.places())
    motion = free_motions(stiffness, rigid)
    if not motion.shape[1]:
        return motion, np.zeros(0, dtype=int), ()
    pins = qr(motion.T, mode="r", pivoting=True)[1][: motion.shape[1]]
    names = [
        name
        for name, single in zip(NAMES, rigid.T, strict=True)
        if free_motions(stiffness, single[:, None]).size
    ]
    others = motion.shape[1] - len(names)
    screws = [f"{others} with rotation and translation"] if others else []
    return motion, pins, (*names, *screws)


def structure_mass(
    problem: CutProblem, bodies: Sequence[Body], densities: Sequence[float]
) -> csr_array:
    """Assemble the mass of a structure on the unknowns of its cut, shape (n, n), kg.

    Parameters
    ----------
    problem : CutProblem, of the bodies
    bodies : sequence of Body
    densities : sequence of float, of each body, kg/m3; bolts have no mass

    Raises
    ------
    CaseError
        If a density is not positive.
    """
    for number, (body, density) in enumerate(zip(bodies, densities, strict=True)):
        if not 0.0 < density < np.inf:
            raise CaseError(
                f"the density of {body.name or f'body {number}'} must be positive (kg/m3), got "
                f"{density:g}; without mass nothing vibrates"
            )
    pairs = zip(bodies, densities, strict=True)
    masses = [assemble_mass(body.basis, density) for body, density in pairs]
    E = problem.expansion
    return csr_array(E.T @ on_diagonal(masses) @ E)


@dataclass(frozen=True, eq=False)
class TangentModes:
    r"""Modes of :math:`K \phi = \omega^2 M \phi`.

    Attributes
    ----------
    square : ndarray, shape (modes,), rising squares :math:`\omega^2` of the frequencies, s⁻²
    shape : ndarray, shape (n, modes)
        Shapes of unit modal mass, :math:`\phi^T M \phi = 1`, kg^-1/2, with a positive largest
        displacement.
    rigid : tuple of str, free rigid motions, which are not among the modes
    coinciding : tuple of tuple of int
        Groups of modes with the same frequency, counted from 0; their shapes move along the axes.
    """

    square: np.ndarray
    shape: np.ndarray
    rigid: tuple[str, ...]
    coinciding: tuple[tuple[int, ...], ...]

    @property
    def frequency(self) -> np.ndarray:
        """Frequencies, Hz."""
        return np.asarray(np.sqrt(self.square) / (2.0 * np.pi))

    def nodal(self, problem: CutProblem) -> np.ndarray:
        """Displacement of all nodes in the shapes, shape (modes, nodes, 3), kg^-1/2."""
        return np.stack([problem.displacement(shape) for shape in self.shape.T])


def tangent_modes(
    problem: CutProblem, stiffness: csr_array, mass: csr_array, count: int
) -> TangentModes:
    r"""Compute the lowest modes of a structure, without its rigid motions.

    Parameters
    ----------
    problem : CutProblem, with the positions of the unknowns
    stiffness : csr_array, shape (n, n), symmetric tangent K with bolts and joints, N/m
    mass : csr_array, shape (n, n), M, kg
    count : int, number of modes

    Returns
    -------
    TangentModes

    Raises
    ------
    CaseError
        If the model has fewer modes, or the tangent is not positive: the preload is unstable.
    MultiscaleError
        If the tangent with the springs below is singular: bodies move without force.

    Notes
    -----
    With the free rigid motions R, :math:`R^T M R = 1`, and the stiffness :math:`\hat K` with as
    many springs to the ground as there are motions, modes belong to the largest eigenvalues of
    :math:`P \hat K^{-1} P^T M`, :math:`P = 1 - R R^T M`: loads in equilibrium have no reaction in
    the springs.
    """
    rigid, pins, names = find_free_motions(problem, stiffness)
    n = stiffness.shape[0]
    if rigid.shape[1]:
        rigid = rigid @ np.linalg.inv(np.linalg.cholesky(rigid.T @ (mass @ rigid))).T
    if not 1 <= count <= n - rigid.shape[1]:
        raise CaseError(
            f"mode {count} is requested, and the model has {n - rigid.shape[1]} modes; count them "
            f"from 1, or give finer meshes"
        )
    wanted = min(count + MORE, n - rigid.shape[1])
    if n <= max(FEW, 4 * wanted):
        square, shape = eigh(stiffness.toarray(), mass.toarray())
        elastic = norm(rigid.T @ (mass @ shape), axis=0) ** 2 < RIGID
        square, shape = square[elastic], shape[:, elastic]
    else:
        springs = np.zeros(n)
        springs[pins] = stiffness.diagonal().mean()
        supported = csr_array(stiffness + diags_array(springs))
        solve = factorise(supported, name="the tangent stiffness of the structure")

        def balanced(force: np.ndarray) -> np.ndarray:
            u = solve(force - mass @ (rigid @ (rigid.T @ force)))
            return np.asarray(u - rigid @ (rigid.T @ (mass @ u)))

        start = np.random.default_rng(seed=0).standard_normal(n)
        inverse = LinearOperator((n, n), matvec=balanced, dtype=float)
        square, shape = eigsh(stiffness, wanted, mass, sigma=0.0, OPinv=inverse, v0=start)
    order = np.argsort(square)[:wanted]
    square, shape = square[order], shape[:, order]
    if square[0] <= 0.0:
        raise CaseError(
            f"the preloaded structure is unstable: its tangent has the negative eigenvalue "
            f"{square[0]:.3g} s-2, so that its rest is not stable; check the laws of the "
            f"interfaces and the preload"
        )
    # modes of the same frequency, and signs of the shapes
    groups = np.split(
        np.arange(square.size), 1 + np.flatnonzero(np.diff(square) > 2.0 * COINCIDE * square[1:])
    )
    for group in groups:
        if group.size > 1:  # principal directions of the mass weighted by the axis of motion
            axis_weight = (1.0 + problem.places()[1] % 3)[:, None]
            together = shape[:, group]
            axes = np.linalg.eigh(together.T @ (axis_weight * (mass @ together)))[1]
            shape[:, group] = together @ axes
    largest = np.argmax(np.abs(shape), axis=0)
    shape = shape * np.sign(shape[largest, np.arange(square.size)])
    coinciding = tuple(
        tuple(group.tolist()) for group in groups if group.size > 1 and group[0] < count
    )
    return TangentModes(square[:count], shape[:, :count], names, coinciding)
