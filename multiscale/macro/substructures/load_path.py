"""Load bodies step by step by named loads, then to and fro by one of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.macro.bodies.assembly import Assembly
from multiscale.macro.data_range import with_load_shares
from multiscale.macro.substructures.bolted_path import Method
from multiscale.macro.substructures.capacity import say_free_motions
from multiscale.macro.substructures.closed_cycles import cycle_work, find_cycles, to_and_fro
from multiscale.macro.substructures.cut_bodies import cut_assembly
from multiscale.macro.substructures.followed_path import solve_path
from multiscale.macro.substructures.joint_state import OPENED, SLIPS, contact_state, joint_shares
from multiscale.macro.substructures.problem import CutProblem
from multiscale.schema import MACRO_RESULT, Dataset

__all__ = ["LoadPath", "follow_cut_loads", "refuse_free", "require_held"]


@dataclass(frozen=True)
class LoadPath:
    """Steps over named loads, one after the other, then cycles of one of them.

    Parameters
    ----------
    names : tuple of str, names of the load cases of an assembly, in the order of the assembly
    forces : tuple of float, resultant of each load at the factor one, N
    steps : tuple of tuple of float, shape (steps, loads)
        Factors of all loads at the end of each step.
    substeps : int, equal parts of every step
    cycled : str, load whose factor then goes to and fro about its last; none if empty
    amplitude : float, by how much that factor rises, then falls
    cycles : int, closed cycles after the first rise
    cycle_steps : int, load steps of that rise: 4 of these make a cycle

    Raises
    ------
    CaseError
        If a value is outside its range, or there is no such load.
    """

    names: tuple[str, ...]
    forces: tuple[float, ...]
    steps: tuple[tuple[float, ...], ...]
    substeps: int = 1
    cycled: str = ""
    amplitude: float = 1.0
    cycles: int = 0
    cycle_steps: int = 10

    def __post_init__(self) -> None:
        if not self.steps or any(len(step) != len(self.names) for step in self.steps):
            raise CaseError(
                f"a path has one step or more with a factor for each of the loads "
                f"{', '.join(self.names)}, got {self.steps}"
            )
        if self.cycles and self.cycled not in self.names:
            raise CaseError(
                f"there is no load {self.cycled!r} to cycle; there are {', '.join(self.names)}"
            )
        if min(self.substeps, self.cycle_steps) < 1 or self.cycles < 0 or not self.amplitude > 0.0:
            raise CaseError(
                f"substeps and cycle_steps count from 1, cycles from 0, and the amplitude is "
                f"positive, got {self.substeps}, {self.cycle_steps}, {self.cycles} and "
                f"{self.amplitude:g}"
            )

    def factors(self) -> np.ndarray:
        """Factors of the loads at every load step, shape (load steps, loads)."""
        ends = np.array([np.zeros(len(self.names)), *self.steps])
        share = (np.arange(1, self.substeps + 1) / self.substeps)[:, None]
        path = [(1.0 - share) * last + share * end for last, end in pairwise(ends)]
        if self.cycles:
            swing = self.amplitude * to_and_fro(self.cycle_steps, self.cycles)
            which = np.array(self.names) == self.cycled
            path.append(ends[-1] + np.outer(swing, which))
        return np.concatenate(path)

    def closed(self) -> list[slice]:
        """Find the load steps of every cycle, with both ends."""
        return find_cycles(self.substeps * len(self.steps), self.cycle_steps, self.cycles)

    def cycle_energy(self, displacement: np.ndarray) -> np.ndarray:
        """Energy that every cycle loses, J, of the displacement of all loads, (load steps, loads).

        See :func:`~.closed_cycles.cycle_work`.
        """
        case = self.names.index(self.cycled)
        q = np.array([displacement[cycle, case] for cycle in self.closed()])
        return np.asarray(self.forces[case] * cycle_work(self.amplitude, q))

    def ends(self) -> np.ndarray:
        """Step that each load step ends, or -1, shape (load steps,)."""
        number = np.full(len(self.factors()), -1)
        last = self.substeps * (1 + np.arange(len(self.steps))) - 1
        number[last] = np.arange(len(self.steps))
        return number


def require_held(assembly: Assembly) -> None:
    """Refuse bodies that may move freely.

    Raises
    ------
    CaseError
        With the bodies and their motions, or as :func:`cut_assembly`.
    """
    refuse_free(assembly, cut_assembly(assembly))


def refuse_free(assembly: Assembly, problem: CutProblem, more: str = "") -> None:
    """Refuse bodies that may move freely in the cut problem of an assembly, with more words."""
    names = [body.name or f"body {number}" for number, body in enumerate(assembly.bodies)]
    if free := say_free_motions(problem, names):
        raise CaseError(
            f"{free}: hold each body by supports, by an interface with friction or by bolts{more}"
        )


def follow_cut_loads(
    problem: CutProblem,
    path: LoadPath,
    *,
    method: Method,
    extrapolate: bool = False,
    near: Dataset | None = None,
) -> Dataset:
    r"""Load a cut structure with interfaces by named loads.

    Parameters
    ----------
    problem : CutProblem
        Its load cases are those of the path; with bolts, the first is their tightening. The small
        one of :func:`~.followed_path.condense_assembly`, for instance.
    path : LoadPath
    method : Method, as of :func:`solve_assembly`
    extrapolate : bool, as of :func:`load_joint`
    near : Dataset, optional, result of this function with other laws, to begin from

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``: what :func:`solve_assembly` gives; of every load its factor, its
        displacement and its stiffnesses; of every interface its pressure and its open and slipping
        shares; and the energy that cycles lose.

    Raises
    ------
    CaseError
        If the path has not one factor for each load case.

    Notes
    -----
    With the nodal forces :math:`f` of a load at the factor one and their resultant F, its
    displacement is :math:`q = f \cdot u / F`: the mean along the load where that is even. It
    counts from bodies without stress whose interfaces have no gap. Its stiffness is
    :math:`F^2 / (f \cdot u)`, by :meth:`~.followed_path.FollowedPath.tangent_work`, against a small
    rise of its factor away from zero, and against changes so small that no point slips. The energy
    of a cycle is :math:`F \oint \lambda\, \mathrm{d}q` with the factor :math:`\lambda`, by
    :func:`~.closed_cycles.cycle_work`; interfaces share it as slip dissipates at their points.
    """
    factors, forces = path.factors(), np.array(path.forces)
    done = solve_path(problem, factors, method, near)
    result, joints, ends = done.result, done.problem.joints, path.ends()
    displacement = done.work / forces
    rests = np.flatnonzero(ends >= 0).tolist()
    (stuck, *_), (whole, of_interfaces, _) = done.tangent_work(
        rests, np.where(factors < 0.0, -1.0, 1.0)
    )
    free = np.isinf(whole)
    values: dict[str, Any] = {
        "path_step": ends,
        "factor": factors,
        "load_displacement": displacement,
        "load_secant": _secants(factors, displacement, forces, not joints),
        "load_stiffness": forces**2 / whole,
        "stuck_stiffness": forces**2 / stuck,
        "interface_compliance": np.where(free, 1.0, of_interfaces / np.where(free, 1.0, whole)),
    }
    if joints:
        values |= contact_state(problem, result)
        result = MACRO_RESULT.assign(result, values)
        result = MACRO_RESULT.assign(result, _of_interfaces(result))
        shares, data = joint_shares(problem, result)
        said = [_say_factors(path.names, row) for row in factors]
        result = with_load_shares(result, shares, data, extrapolate=extrapolate, loads=said)
    else:
        result = MACRO_RESULT.assign(result, values)
    if path.cycles:
        energies: dict[str, Any] = {
            "cycle_energy": path.cycle_energy(result["load_displacement"].to_numpy())
        }
        if joints:
            weighted = result["dissipation"].to_numpy() * result["point_area"].to_numpy()
            own = _by_interface(result, weighted)
            slipped = np.array([own[cycle][1:].sum(axis=0) for cycle in path.closed()])
            total = slipped.sum(axis=1, keepdims=True)
            share = slipped / np.where(total > 0.0, total, 1.0)
            energies["interface_energy"] = share * energies["cycle_energy"][:, None]
        result = MACRO_RESULT.assign(result, energies).assign_coords(cycle=range(path.cycles))
    return result.assign_coords(load=list(path.names))


def _say_factors(names: Sequence[str], factors: np.ndarray) -> str:
    """Say the factors of the loads that are not zero."""
    said = [f"{name} {one:.4g}" for name, one in zip(names, factors, strict=True) if one]
    return "the loads " + (", ".join(said) or "zero")


def _by_interface(result: Dataset, values: np.ndarray) -> np.ndarray:
    """Sum over the points of every interface, shape (steps, interfaces)."""
    number = result["point_joint"].to_numpy()
    return np.stack([values[:, number == one].sum(axis=1) for one in np.unique(number)], axis=1)


def _of_interfaces(result: Dataset) -> dict[str, np.ndarray]:
    """Mean pressure of every interface, and its open and slipping shares."""
    area, pressure = result["point_area"].to_numpy(), -result["traction"].to_numpy()[..., 0]
    state = result["contact_state"].to_numpy()
    known = np.where(np.isnan(state), np.nan, 1.0)
    whole = _by_interface(result, known * area)
    return {
        "interface_pressure": _by_interface(result, pressure * area) / whole,
        "interface_open": _by_interface(result, known * (state == OPENED) * area) / whole,
        "interface_slip": _by_interface(result, known * (state == SLIPS) * area) / whole,
    }


def _secants(
    factors: np.ndarray, displacement: np.ndarray, forces: np.ndarray, at_rest: bool
) -> np.ndarray:
    """Stiffness of every load since it was zero, if it alone has changed since, N/m, else NaN.

    Before the first step bodies are at rest if no interface joins them, whose gap is not known
    without load.
    """
    first = np.zeros((int(at_rest), len(forces)))
    factor, moved = np.vstack([first, factors]), np.vstack([first, displacement])
    found = np.full(factor.shape, np.nan)
    for case, force in enumerate(forces):
        others = np.delete(factor, case, axis=1)
        for step in range(1, len(factor)):
            zero = np.flatnonzero(factor[:step, case] == 0.0)
            if not zero.size or factor[step, case] == 0.0:
                continue
            begin = zero[-1]
            if np.all(others[begin : step + 1] == others[begin]):
                change = force * factor[step, case]
                found[step, case] = change / (moved[step, case] - moved[begin, case])
    return found[len(first) :]
