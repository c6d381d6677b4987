"""One assembly, three ways to solve it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from multiscale.macro.bodies.assembly import Assembly
from multiscale.macro.substructures.bolted_path import Method, follow_bolts
from multiscale.macro.substructures.cut_bodies import cut_assembly
from multiscale.macro.substructures.latin_solver import solve_latin
from multiscale.macro.substructures.parallel import ProcessGroup
from multiscale.macro.substructures.schur import solve_schur
from multiscale.macro.substructures.whole_solver import solve_whole
from multiscale.schema import Dataset

__all__ = ["AssembledNewton", "LatinMethod", "NewtonSchur", "solve_assembly"]


@dataclass(frozen=True)
class AssembledNewton(Method):
    """Newton's method on the whole, uncut: the fastest where its factors fit into memory.

    It takes all laws but rigid contact, on one process; see :func:`solve_whole`.
    """

    name: ClassVar[str] = "Newton's method on the whole"
    solver: ClassVar[Callable[..., Dataset]] = solve_whole
    condenses: ClassVar[bool] = True


@dataclass(frozen=True)
class LatinMethod(Method):
    """Micro-macro LATIN: all laws, rigid contact too, and many processes; see :func:`solve_latin`.

    It alone gives an indicator of the error.
    """

    name: ClassVar[str] = "LATIN"
    solver: ClassVar[Callable[..., Dataset]] = solve_latin
    tolerance: float = 1e-8
    max_iterations: int = 400
    coarse: bool = True
    team: ProcessGroup | None = None


@dataclass(frozen=True)
class NewtonSchur(Method):
    """Newton's method with a balanced Schur complement; see :func:`solve_schur`.

    It takes all laws but rigid contact, on many processes.
    """

    name: ClassVar[str] = "Newton-Schur"
    solver: ClassVar[Callable[..., Dataset]] = solve_schur
    team: ProcessGroup | None = None


def solve_assembly(
    assembly: Assembly,
    load_factor: float | np.ndarray = 1.0,
    *,
    method: Method = AssembledNewton(),  # frozen
    after: Dataset | None = None,
) -> Dataset:
    """Solve elastic bodies with interfaces, step by step.

    Parameters
    ----------
    assembly : Assembly
    load_factor : float or ndarray, shape (steps,) or (steps, cases)
        Factors of the load cases, one row for each step; each starts from the one before. Where
        there are bolts, the first factor is of their preloads, and a step that changes it tightens
        them: :func:`~.bolted_path.follow_bolts`.
    method : Method, :class:`AssembledNewton`, :class:`LatinMethod` or :class:`NewtonSchur`
    after : Dataset, optional
        An earlier path by the same method and cut, maybe under other loads: the first step goes on
        from its last, and its steps come first in the result.

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``: displacement of the nodes of all bodies one after the other,
        jump and traction at the points of the interfaces, which are nodes, in their own frame
        (normal, then both tangents), and the force of the bolts. A step that did not converge, or
        at which a bolt comes loose, is NaN with ``converged`` 0, the later ones are not tried, and
        the attribute ``failure`` says why. Points come in the order of the pairs of substructures
        that meet; ``point_joint`` is the interface of each.

    Raises
    ------
    CaseError
        If a body is not elastic, a support moves, faces do not match, a substructure is in
        pieces, or load factors do not fit the load cases.

    Examples
    --------
    >>> from multiscale.laws import Exponential, Sliders
    >>> from multiscale.laws.bulk import Elastic
    >>> from multiscale.macro.bodies import stacked_blocks
    >>> law = Sliders(Exponential(1e9, 0.2e-6), 0.2, pressures=(1e6, 1e8))
    >>> blocks = stacked_blocks((0.02, 0.02, 0.02), (2, 2, 1), [Elastic(210e9, 0.3)] * 2, [law])
    >>> pressed = solve_assembly(blocks, np.array([[10e6, 0.0]]))  # Pa
    >>> float((pressed["traction"][0, :, 0] @ pressed["point_area"]).round(6))  # N
    -4000.0
    """
    return follow_bolts(cut_assembly(assembly, method.parts), load_factor, method, after)
