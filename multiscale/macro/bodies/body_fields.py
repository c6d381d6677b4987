"""Stress and strain energy of the elements of bodies from the displacement."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.fe.mesh_file import HEX_ORDER
from multiscale.laws.bulk import respond_bulk
from multiscale.macro.continuum.body import Body
from multiscale.schema import MACRO_RESULT, Dataset


def add_body_fields(
    result: Dataset, bodies: Sequence[Body], *, damage: Sequence[float] = ()
) -> Dataset:
    r"""Add elements, their stress and their strain energy to a result of cut bodies.

    Parameters
    ----------
    result : Dataset, follows ``MACRO_RESULT``: solution of :func:`cut_assembly` of these bodies
    bodies : sequence of Body, elastic, all of tetrahedra or all of hexahedra
    damage : sequence of float
        Damage of every body, to be stored with its elements; their laws already contain it.

    Returns
    -------
    Dataset
        With ``corners``, ``element_body``, ``equivalent_stress`` (Pa), ``energy_density``
        (J/m³) and, if damage is given, ``element_damage``. A step that failed is NaN.

    Notes
    -----
    The stress of an element is the mean over its volume; with its deviator :math:`s` the
    equivalent stress is :math:`\sqrt{3/2}\, |s|`. The density is the mean of
    :math:`\sigma : \nabla u / 2`.
    """
    first = np.cumsum([0, *(body.basis.N for body in bodies)])
    if result.sizes["node"] != first[-1]:
        raise CaseError(
            f"the result has {result.sizes['node']} nodes and the bodies {first[-1]}; give the "
            f"bodies of the result"
        )
    u = result["displacement"].values
    fields = [
        _fields(body, u[:, a:b]) for body, (a, b) in zip(bodies, pairwise(first), strict=True)
    ]
    values: dict[str, Any] = {
        **list_elements(bodies),
        "equivalent_stress": np.concatenate([stress for stress, _ in fields], axis=1),
        "energy_density": np.concatenate([energy for _, energy in fields], axis=1),
    }
    if damage:
        values["element_damage"] = np.asarray(damage)[values["element_body"]]
    return MACRO_RESULT.assign(result, values)


def list_elements(bodies: Sequence[Body]) -> dict[str, np.ndarray]:
    """Return ``corners`` and ``element_body`` of ``MACRO_RESULT`` for bodies in turn."""
    if len({body.mesh.t.shape[0] for body in bodies}) > 1:
        raise CaseError("the bodies have elements of two kinds; mesh all with the same kind")
    first = np.cumsum([0, *(body.basis.N for body in bodies)])
    count = [body.mesh.t.shape[1] for body in bodies]
    corners = [element_corners(body) + start for body, start in zip(bodies, first, strict=False)]
    return {
        "corners": np.concatenate(corners),
        "element_body": np.repeat(np.arange(len(bodies)), count),
    }


def element_stress(body: Body, displacement: np.ndarray) -> np.ndarray:
    """Mean stress of the sound material at the strain of every element.

    Parameters
    ----------
    body : Body, elastic
    displacement : ndarray, shape (steps, nodes, 3), m

    Returns
    -------
    ndarray, shape (steps, elements, 6)
        xx, yy, zz, yz, xz, xy, Pa. The ``share`` of an element multiplies it.
    """
    stress = np.stack([_mean_fields(body, u)[0] for u in displacement])
    i, j = np.array([(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)]).T
    return np.asarray(stress[:, i, j].swapaxes(1, 2))


def _fields(body: Body, displacement: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Equivalent stress and energy density of the elements, shape (steps, elements) each."""
    share = 1.0 if body.share is None else body.share
    stresses, energies = [], []
    for u in displacement:
        mean, energy = _mean_fields(body, u)
        deviator = mean - np.trace(mean) / 3.0 * np.eye(3)[:, :, None]
        stresses.append(share * np.sqrt(1.5 * np.sum(deviator**2, axis=(0, 1))))
        energies.append(share * energy)
    return np.array(stresses), np.array(energies)


def _mean_fields(body: Body, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean stress, (3, 3, elements), and energy density of the sound material, (elements,)."""
    basis = body.basis
    slopes = np.stack([np.asarray(shape[0].grad) for shape in basis.basis])  # (a, 3, e, points)
    weight = basis.dx / basis.dx.sum(axis=1, keepdims=True)
    gradient = np.einsum("aei,ajep->ijep", u[basis.element_dofs], slopes)
    at = np.eye(3)[:, :, None, None] + gradient
    stress = respond_bulk(body.law, at, np.zeros((0, *weight.shape))).stress
    energy = 0.5 * np.einsum("ijep,ijep,ep->e", stress, gradient, weight)
    return np.einsum("ijep,ep->ije", stress, weight), energy


def element_corners(body: Body) -> np.ndarray:
    """Nodes of the elements of a body in the order of VTK, shape (elements, corners)."""
    from skfem import MeshHex

    corners = body.mesh.t.copy()
    if isinstance(body.mesh, MeshHex):
        corners[HEX_ORDER] = body.mesh.t
    return np.asarray(corners.T)
