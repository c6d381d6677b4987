r"""Homogenised substructures: a coarse structure of corners and motions of edges.

Every edge moves by polynomials of the position, :math:`u_\Gamma = \Phi q`, cubic so that it bends;
with taut links the inside follows, eqs (12) and (13) of the source:

.. math::
    u = V q, \qquad
    V = \begin{pmatrix} \Phi & 0 \\ -K_{ii}^{-1} K_{i\Gamma} \Phi & K_{ii}^{-1} f_i \end{pmatrix},
    \qquad K^H = V^T (K + B^T k B) V.    \tag{1}
"""

from collections.abc import Callable
from itertools import product
from typing import Any, NamedTuple, TypeVar

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array, eye_array, hstack, vstack

from multiscale.errors import CaseError, MultiscaleError
from multiscale.macro.data_range import without_steps
from multiscale.macro.substructures.problem import (
    CutInterface,
    CutProblem,
    Links,
    Substructure,
    join_links,
)
from multiscale.macro.substructures.stepping import FIELDS
from multiscale.numerics.factorisation import factorise
from multiscale.schema import MACRO_RESULT, Dataset

Value = TypeVar("Value")

DEGREE = 3
"""Degree of the motions of edges."""

INDEPENDENT = 1e-8
"""Singular value of a motion, relative to the largest, below which it depends on the others."""

ROUNDING = 1e-9
"""Tension outside the range of a link, relative to the largest, that is ascribed to rounding."""

MOST_SLACK = 0.5
"""Share of the substructures with links outside their range above which all are resolved."""

DIGITS = 9
"""Decimal digits in which substructures and edges agree that share their condensed stiffness."""


def solve_homogenised(
    problem: CutProblem,
    solve: Callable[[CutProblem], Dataset],
    *,
    adaptive: bool = True,
) -> Dataset:
    """Solve a structure of links by its homogenised substructures.

    Parameters
    ----------
    problem : CutProblem, the structure, cut; its prestress in equilibrium
    solve : callable
        Solves a problem at rest or in motion, such as ``NewtonSchur().solve`` or a call of
        :func:`simulate_latin`. It is called for the coarse structure, of one substructure, and for
        ``problem`` where all substructures are resolved.
    adaptive : bool
        Whether substructures are resolved in which links leave their range. Otherwise such steps
        are refused.

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``, with the tension and slack of all links. Attributes:
        ``unknowns`` of the coarse structure, ``substructures``, and ``resolved``, the number of
        resolved substructures. A step fails where the solver does, or where a homogenised
        substructure has links outside their range.

    Raises
    ------
    CaseError
        If the structure has joints or no links, its prestress is not in equilibrium, or a
        substructure is a mechanism while its interfaces rest.

    Examples
    --------
    >>> from multiscale.macro import NewtonSchur, cut_links, tensegrity_grid
    >>> from multiscale.macro.substructures import split_grid
    >>> grid = tensegrity_grid(8)
    >>> problem = cut_links(grid, split_grid(grid, (2, 2)))
    >>> result = solve_homogenised(problem, lambda coarse: NewtonSchur().solve(coarse, [0.1]))
    >>> result.converged.item(), result.resolved
    (1, 0)
    """
    every = join_links(problem.substructures)
    _check(problem, every)
    cells = _Cells(problem, every)
    resolved = np.zeros(len(problem.substructures), dtype=bool)
    while True:
        coarse = problem if resolved.all() else cells.assemble(resolved)
        result = solve(coarse)
        # links outside their range, in homogenised substructures
        solved = np.flatnonzero(result["converged"].to_numpy() == 1)
        elastic = _elastic(problem, every, result["displacement"].to_numpy()[solved])
        tension = np.clip(elastic, every.lower, every.upper)
        excess = np.abs(tension - elastic)
        beyond = excess > ROUNDING * np.abs(elastic).max(initial=0.0)
        beyond &= ~resolved[cells.owner]
        if not adaptive or not beyond.any():
            break
        resolved[cells.owner[beyond.any(axis=0)]] = True
        resolved |= resolved.mean() > MOST_SLACK

    # tension and slack of all links, in their order
    shape = result.sizes["step"], problem.n_links
    fields = {"tension": np.full(shape, np.nan), "slack": np.full(shape, np.nan)}
    fields["tension"][solved[:, None], every.number] = tension
    fields["slack"][solved[:, None], every.number] = excess / every.stiffness
    result = MACRO_RESULT.assign(result.drop_dims("link", errors="ignore"), fields)
    result = result.assign_attrs(
        unknowns=coarse.n, substructures=resolved.size, resolved=int(resolved.sum())
    )
    return _refuse_slack(result, solved, beyond)


def _check(problem: CutProblem, links: Links) -> None:
    if problem.joints or not problem.n_links:
        raise CaseError(
            "homogenised substructures consist of links, without joints; leave out model"
        )
    force = problem.sum_up([links.operator.T @ links.prestress])
    largest = np.abs(links.prestress).max()
    if np.abs(force).max(initial=0.0) > 1e-6 * largest:
        raise CaseError(
            f"homogenised substructures need a prestress in equilibrium, and a node has a force of "
            f"{np.abs(force).max():.4g} N with the largest tension {largest:.4g} N; give a state "
            f"of self-stress"
        )


def _refuse_slack(result: Dataset, solved: np.ndarray, beyond: np.ndarray) -> Dataset:
    """Refuse steps in which homogenised substructures have links outside their range."""
    wrong = beyond.any(axis=1)
    if not wrong.any():
        return result
    steps = np.isin(np.arange(result.sizes["step"]), solved[wrong])
    return without_steps(result, steps, (*FIELDS, "velocity")).assign_attrs(
        failure=f"in step {solved[wrong][0]} {np.count_nonzero(beyond[wrong][0])} links of "
        f"homogenised substructures would leave the range of their laws, where their stiffness "
        f"is not valid; use the model adaptive, which resolves them"
    )


def _elastic(problem: CutProblem, every: Links, displacement: np.ndarray) -> np.ndarray:
    """Tension without slack, N, of the links in turn, from displacements (steps, nodes, c), m."""
    u = problem.unknowns(displacement)[:, problem.numbers]
    return np.asarray(every.prestress + every.stiffness * (every.operator @ u.T).T)


class _Cell(NamedTuple):
    """A substructure in its coarse motions, by (1)."""

    motion: csr_array  # V, (n, q)
    stiffness: csr_array  # of the linear elements, V^T K V, (q, q), N/m
    stretch: csr_array  # R, R^T R = V^T B^T k B V of taut links, (rows, q), (N/m)^1/2
    load: np.ndarray  # V^T f, (q, cases), N


class _Cells:
    """Condensed substructures of a structure; equal substructures are condensed once."""

    def __init__(self, problem: CutProblem, links: Links) -> None:
        self.problem, self.links = problem, links
        counts = [each.n_links for each in problem.substructures]
        self.owner = np.repeat(np.arange(len(counts)), counts)
        self.known: dict[bytes, Any] = {}
        self.faces = [
            [(number, problem.interfaces[number].trace[side].indices) for number, side in sides]
            for sides in problem.sides
        ]
        self.edges = [self._edge(face) for face in problem.interfaces]

    def _remember(self, key: tuple[np.ndarray, ...], evaluate: Callable[[], Value]) -> Value:
        """Return the earlier value for arrays that agree, or evaluate it."""
        digits = b"".join(
            np.round(array / (size := np.abs(array).max(initial=0.0) or 1.0), DIGITS).tobytes()
            + f"{size:.{DIGITS}g} {array.shape}".encode()
            for array in key
        )
        if digits not in self.known:
            self.known[digits] = evaluate()
        value: Value = self.known[digits]
        return value

    def _edge(self, face: CutInterface) -> np.ndarray:
        """Polynomial motions of an edge, or all motions of a corner, (size, motions)."""
        side, at = self.problem.substructures[face.sides[0]], face.trace[0].indices
        x, component = side.position[at] - side.position[at].mean(axis=0), side.component[at]
        if len(face.sides) > 2:
            return np.eye(face.size)
        return self._remember((x, component), lambda: polynomial_motions(x, component))

    def assemble(self, resolved: np.ndarray) -> CutProblem:
        """Assemble the coarse structure, with some substructures resolved."""
        problem = self.problem
        # coarse unknowns of interfaces, with all motions next to resolved substructures
        motions = [
            np.eye(face.size) if resolved[list(face.sides)].any() else motion
            for face, motion in zip(problem.interfaces, self.edges, strict=True)
        ]
        first = np.cumsum([0, *(motion.shape[1] for motion in motions)])
        count, new = int(first[-1]), np.ones(problem.n, dtype=bool)
        expand, stiffness, stretch, load = list[Any](), list[Any](), list[Any](), list[Any]()
        rows = 0  # of links
        for owner, each in enumerate(problem.substructures):
            cell = self._resolve(owner, motions) if resolved[owner] else self._cell(owner, motions)
            shared = [np.arange(first[face], first[face + 1]) for face, _ in self.faces[owner]]
            more = cell.load.shape[0] - sum(map(len, shared))  # inside
            number = np.concatenate([*shared, np.arange(count, count + more)]).astype(int)
            count += more
            # u = T w, where shared unknowns count once, and stiffness and load of w
            first_met = np.flatnonzero(new[each.unknown])
            new[each.unknown] = False
            expand.append(_entries(cell.motion[first_met], each.unknown[first_met], number))
            taut = np.arange(rows, rows + cell.stretch.shape[0])
            stretch.append(_entries(cell.stretch, taut, number))
            rows += taut.size
            stiffness.append(_entries(cell.stiffness, number, number))
            load.append(_entries(csr_array(cell.load), number, np.arange(problem.n_cases)))
        T = _sum(expand, (problem.n, count))
        position, component = problem.places()
        most = np.asarray(abs(T).argmax(axis=0)).ravel()  # unknowns that move most
        coarse = Substructure(
            _sum(stiffness, (count, count)),
            _sum(load, (count, problem.n_cases)).toarray(),
            np.arange(count),
            position[most],
            component[most],
            self._links(resolved, T, _sum(stretch, (rows, count))),
        )
        return CutProblem((coarse,), problem.position, csr_array(problem.expansion @ T))

    def _links(self, resolved: np.ndarray, expansion: csr_array, taut: csr_array) -> Links:
        """Links by their change of tension, as prestress balances: taut, then resolved links."""
        links, zero, rows = self.links, np.zeros(taut.shape[0]), resolved[self.owner]
        stretch = csr_array(links.operator[rows]) @ expansion[self.problem.numbers]
        operator = csr_array(vstack([taut, stretch]))
        stiffness = np.append(zero + 1.0, links.stiffness[rows])
        lower = np.append(zero - np.inf, (links.lower - links.prestress)[rows])
        upper = np.append(zero + np.inf, (links.upper - links.prestress)[rows])
        count = stiffness.size
        return Links(operator, stiffness, np.zeros(count), lower, upper, np.arange(count))

    def _place(self, owner: int, motions: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Motions of all interfaces of a substructure, (n, motions), and its unknowns inside."""
        faces, n = self.faces[owner], self.problem.substructures[owner].n
        start = np.cumsum([0, *(motions[face].shape[1] for face, _ in faces)])
        placed, inside = np.zeros((n, start[-1])), np.ones(n, dtype=bool)
        for (face, at), a, b in zip(faces, start, start[1:], strict=False):
            placed[at, a:b], inside[at] = motions[face], False
        return placed, np.flatnonzero(inside)

    def _resolve(self, owner: int, motions: list[np.ndarray]) -> _Cell:
        """Evaluate (1) with all unknowns inside a substructure as coarse unknowns."""
        each, (placed, inside) = self.problem.substructures[owner], self._place(owner, motions)
        inner = csr_array(eye_array(each.n, format="csr")[:, inside])
        V = csr_array(hstack([csr_array(placed), inner]))
        none = csr_array((0, V.shape[1]))
        return _Cell(V, csr_array(V.T @ each.stiffness @ V), none, V.T @ each.load)

    def _cell(self, owner: int, motions: list[np.ndarray]) -> _Cell:
        """Evaluate (1)."""
        each = self.problem.substructures[owner]
        placed, inside = self._place(owner, motions)
        rows = csr_array((0, each.n))
        if each.links is not None:
            rows = csr_array(diags_array(np.sqrt(each.links.stiffness)) @ each.links.operator)
        K = each.stiffness
        matrices = [part for each in (K, rows) for part in (each.data, each.indices, each.indptr)]
        return self._remember(
            (*matrices, each.load, placed),
            lambda: _condense(K, rows, each.load, placed, inside, owner),
        )


def polynomial_motions(position: np.ndarray, component: np.ndarray) -> np.ndarray:
    """Orthonormal polynomials of a position, (size, 3), for each component, (size, motions)."""
    x = position / (np.abs(position).max() or 1.0)
    powers = [power for power in product(range(DEGREE + 1), repeat=3) if sum(power) <= DEGREE]
    fields = np.stack([np.prod(x**power, axis=1) for power in powers], axis=1)
    motions = [fields * (component == c)[:, None] for c in np.unique(component)]
    left, size, _ = np.linalg.svd(np.concatenate(motions, axis=1), full_matrices=False)
    return np.asarray(left[:, size > INDEPENDENT * size[0]])


def _condense(
    stiffness: csr_array,
    rows: csr_array,
    load: np.ndarray,
    placed: np.ndarray,
    inside: np.ndarray,
    owner: int,
) -> _Cell:
    """Evaluate (1) from motions of the interfaces, (n, motions), and the unknowns inside."""
    K = (stiffness + rows.T @ rows).toarray()
    V, loads = placed.copy(), np.zeros(load.shape)
    if inside.size:
        try:
            solve = factorise(K[np.ix_(inside, inside)])
        except MultiscaleError as error:
            raise CaseError(
                f"substructure {owner} is a mechanism with fixed interfaces, so it has no "
                f"condensed stiffness: brace it, or cut it elsewhere"
            ) from error
        V[inside], loads[inside] = -solve((K @ placed)[inside]), solve(load[inside])
    size = np.abs(loads).max(axis=0, initial=0.0)
    V = np.column_stack([V, loads[:, size > 0.0] / size[size > 0.0]])
    R = np.linalg.qr(rows @ V, mode="r")
    return _Cell(csr_array(V), csr_array(V.T @ stiffness @ V), csr_array(R), V.T @ load)


def _entries(
    block: csr_array, row: np.ndarray, column: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    place = coo_array(block)
    return place.data, row[place.coords[0]], column[place.coords[1]]


def _sum(entries: list[Any], shape: tuple[int, int]) -> csr_array:
    value, row, column = (np.concatenate(item) for item in zip(*entries, strict=True))
    return csr_array(coo_array((value, (row, column)), shape=shape))
