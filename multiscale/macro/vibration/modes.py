"""Rest of a structure under its preload, and modes of small vibration about it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm
from scipy.linalg import eigh, qr
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import LinearOperator, eigsh

from multiscale.errors import CaseError, ConvergenceError
from multiscale.fe.elasticity import assemble_mass, free_motions, rigid_motions
from multiscale.fe.multigrid import joint_matrix
from multiscale.laws.interface_law import InterfaceLaw, SideBySide
from multiscale.macro.bodies.assembly import Assembly
from multiscale.macro.continuum.body import Body
from multiscale.macro.data_range import with_load_shares
from multiscale.macro.substructures.capacity import refuse_free
from multiscale.macro.substructures.cut import cut_assembly
from multiscale.macro.substructures.measures import joint_shares
from multiscale.macro.substructures.problem import CutProblem
from multiscale.macro.substructures.stepping import (
    FollowedPath,
    JointState,
    PreparedStructure,
    follow,
)
from multiscale.macro.substructures.whole import (
    AssembledNewton,
    CondensedProblem,
    assemble,
    condense_problem,
)
from multiscale.numerics.factorisation import factorise, on_diagonal
from multiscale.schema import Dataset

FEW = 600  # unknowns up to which a dense solver computes all modes
MORE = 2  # modes computed beyond the last requested mode, to detect coinciding frequencies

COINCIDE = 1e-4
"""Distance of two frequencies, relative to them, up to which their shapes are not determined."""

RIGID = 0.5  # share of the mass of a mode in rigid motions from which it counts as rigid

NAMES = ("along x", "along y", "along z", "about x", "about y", "about z")


def find_free_motions(
    problem: CutProblem, stiffness: csr_array
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Determine the rigid motions of all bodies together that the stiffness does not resist."""
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
    densities : sequence of float, of each body, kg/m3; bolts have no mass
    """
    for number, (body, density) in enumerate(zip(bodies, densities, strict=True)):
        if not 0.0 < density < np.inf:
            raise CaseError(
                f"the density of {body.name or f'body {number}'} must be positive (kg/m3), got "
                f"{density:g}; a vibration needs mass"
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
    needed = min(count + MORE, n - rigid.shape[1])
    if n <= max(FEW, 4 * needed):
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
        square, shape = eigsh(stiffness, needed, mass, sigma=0.0, OPinv=inverse, v0=start)
    order = np.argsort(square)[:needed]
    square, shape = square[order], shape[:, order]
    if square[0] <= 0.0:
        raise CaseError(
            f"the preloaded structure is unstable: its tangent has the negative eigenvalue "
            f"{square[0]:.3g} s-2, so its state at rest is unstable; check the laws of the "
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


LARGEST = 6000
"""Limit of the boundary unknowns of condensed bodies: their dense matrix is factorised once, and a
matrix of half its size in every step."""

STIFFEST = 1e5
"""Stiffness of a law, relative to the bodies, above which a joint counts as rigid in modes: a
matrix with stiffer joints could not be factorised."""


@dataclass(frozen=True, eq=False)
class Preloaded:
    """A structure at rest.

    Attributes
    ----------
    free : CutProblem, the structure on its supports, if any
    condensed : CondensedProblem
        The same structure with springs against free rigid motions of the whole.
    path : Dataset, follows ``MACRO_RESULT``, the steps of the preload on the small problem
    law : SideBySide, laws of all joints for further loads, without plastic flow
    followed : FollowedPath, the preload
    """

    free: CutProblem
    condensed: CondensedProblem
    path: Dataset
    law: SideBySide
    followed: FollowedPath

    @property
    def state(self) -> JointState:
        """State at the end of the preload."""
        return self.followed.end

    def tangent(self) -> csr_array:
        """Stiffness of the whole against small changes, N/m, shape (whole.n, whole.n).

        Bolts are locked, and no point slips.
        """
        whole, law = assemble(self.free.with_locked_bolts()), self.law
        tangent = law.respond(self.state.jump, law.unsheared(self.state.history)).tangent
        B, points = whole.jump, whole.weight.size
        if points:
            most = STIFFEST * whole.resistance
            size = np.abs(tangent).max(axis=(0, 1))
            tangent = tangent * np.minimum(1.0, most / np.where(size > 0.0, size, most))
        stiffness = whole.stiffness + B.T @ joint_matrix(whole.weight * tangent) @ B
        return csr_array(0.5 * (stiffness + stiffness.T))


def press_structure(
    assembly: Assembly,
    factors: np.ndarray,
    *,
    preload_laws: Sequence[InterfaceLaw] | None = None,
    extrapolate: bool = False,
    near: Preloaded | None = None,
) -> Preloaded:
    """Solve for the rest of a structure under its preload.

    Parameters
    ----------
    assembly : Assembly
        Supports, interfaces and bolts connect its bodies; the whole may be free if its loads are in
        equilibrium.
    factors : ndarray, shape (steps, cases), factors of its loads, with bolts first of the preloads
    preload_laws : sequence of InterfaceLaw, optional
        Laws of the interfaces during the preload, such as frictionless laws, with the same states.
    extrapolate : bool
        Whether pressures may lie far outside the data of the laws; see
        :func:`~multiscale.macro.data_range.with_load_shares`.
    near : Preloaded, optional
        The same bodies under other laws and loads; provides the condensed stiffness, and initial
        guesses.

    Raises
    ------
    CaseError
        If a body is free to move separately, or as :func:`cut_assembly`.
    ConvergenceError
        If the preload has no equilibrium, or is far outside the data of a law.
    """
    # condensed structure, with springs against its free rigid motions
    free = cut_assembly(assembly)
    supported = _add_springs(free)
    refuse_free(assembly, supported, "; the structure as a whole may be free")
    insides = near.condensed.insides if near else ()
    condensed = condense_problem(supported, largest=LARGEST, insides=insides)
    joints = condensed.small.joints
    if joints and condensed.small is supported and supported.n > LARGEST:
        raise CaseError(
            f"interfaces and bolts have too many of {supported.n} unknowns to condense the bodies "
            f"onto them, {LARGEST} at most; mesh the faces of interfaces coarser"
        )

    # path of the preload
    pressed = condensed.small
    if preload_laws is not None:
        pressed = pressed.with_laws(preload_laws)
    guesses = near.followed if near and near.followed.unknowns.shape[1] == pressed.n else None
    followed = follow(PreparedStructure(pressed, AssembledNewton()), factors, near=guesses)
    path = followed.result
    if not path["converged"].values.all():
        raise ConvergenceError(f"the preload has no equilibrium: {path.attrs['failure']}")

    # pressures outside the data of the laws
    if joints:
        shares, data = joint_shares(pressed, path)
        loads = ["its preload"] * path.sizes["step"]
        path = with_load_shares(path, shares, data, extrapolate=extrapolate, loads=loads)
        if not (extrapolate or path["known"].values[-1]):
            raise ConvergenceError(f"the preload is unknown: {path.attrs['cautions']}")
    return Preloaded(free, condensed, path, condensed.small.law.shaken_down(), followed)


def require_joined(assembly: Assembly) -> None:
    """Refuse bodies that may move against each other; the structure as a whole may be free.

    Raises
    ------
    CaseError
        With the bodies and their motions, or as ``cut_assembly``.
    """
    supported = _add_springs(cut_assembly(assembly))
    refuse_free(assembly, supported, "; the structure as a whole may be free")


def _add_springs(problem: CutProblem) -> CutProblem:
    """Add springs against the free rigid motions of the whole structure."""
    # stiffness with bonded joints, without tangential stiffness where they are frictionless
    whole = assemble(problem)
    size = whole.stiffness.diagonal().mean()
    k = np.full((3, whole.weight.size), size)
    k[1:] *= np.sign(problem.law.friction_limit(np.ones(whole.weight.size)))
    B = whole.jump
    K = csr_array(whole.stiffness + B.T @ diags_array(k.ravel()) @ B)

    springs = np.zeros(problem.n)
    springs[find_free_motions(problem, K)[1]] = size
    return problem.with_stiffness(csr_array(diags_array(springs)))
