r"""The three configurations of the source: relaxed, prestressed and actual."""

from dataclasses import dataclass, replace

import numpy as np

from multiscale.errors import CaseError
from multiscale.macro.discrete.link_system import LinkSystem

__all__ = ["Configuration", "actual", "prestressed", "relaxed", "with_relaxed_length"]


@dataclass(frozen=True, eq=False)
class Configuration:
    r"""Lengths and tensions of the links in a configuration.

    Attributes
    ----------
    distance : ndarray, shape (links,), distance of the ends, m
    elongation : ndarray, shape (links,), elongation of the link beyond its relaxed length, m
    slack : ndarray, shape (links,)
        Length of a slack cable minus the distance of its ends (of a strut the opposite), m.
    tension : ndarray, shape (links,), N
    """

    distance: np.ndarray
    elongation: np.ndarray
    slack: np.ndarray
    tension: np.ndarray


def relaxed(system: LinkSystem) -> Configuration:
    r"""Return the configuration :math:`\Omega_{-1}`, in which every link is free of stress.

    By (14) of the source, :math:`\tau^0 = k e^0`; the relaxed length is :math:`L - e^0`. The
    relaxed links are not compatible.
    """
    nothing = np.zeros(system.n_links)
    length = system.length - system.prestress / system.stiffness
    return Configuration(length, nothing, nothing, nothing)


def prestressed(system: LinkSystem) -> Configuration:
    r"""Return the configuration :math:`\Omega_0`, with prestress and without load."""
    elongation = system.prestress / system.stiffness
    return Configuration(system.length, elongation, np.zeros(system.n_links), system.prestress)


def actual(system: LinkSystem, displacement: np.ndarray) -> Configuration:
    r"""Return the configuration :math:`\Omega_\alpha` after small displacements.

    Parameters
    ----------
    system : LinkSystem
        Structure of extensible links.
    displacement : ndarray, shape (nodes, c)
        Displacement, m, as returned by :func:`solve_static`.

    Raises
    ------
    CaseError
        If a link has a fixed length: its tension does not follow from the displacement.
    """
    if np.isinf(system.stiffness).any():
        raise CaseError("the tension of a link of fixed length does not follow from displacements")
    move = displacement[system.ends[:, 1], :3] - displacement[system.ends[:, 0], :3]
    change = np.einsum("li,li->l", system.direction, move)
    elastic = system.prestress + system.stiffness * change
    tension = np.clip(elastic, *system.bounds)
    return Configuration(
        system.length + change,
        tension / system.stiffness,
        np.abs(tension - elastic) / system.stiffness,
        tension,
    )


def with_relaxed_length(system: LinkSystem, length: np.ndarray) -> LinkSystem:
    r"""Return a structure with the prestress of links of given relaxed lengths.

    Parameters
    ----------
    system : LinkSystem
        Structure whose prestress is replaced by :math:`k (L - \ell)`, (14) of the source.
    length : ndarray, shape (links,)
        Relaxed lengths :math:`\ell`, m.

    Raises
    ------
    CaseError
        If this prestress is out of balance or outside the bounds of a link.
    """
    return replace(system, prestress=system.stiffness * (system.length - length))
