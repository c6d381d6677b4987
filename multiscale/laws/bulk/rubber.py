"""Rubber: a compressible neo-Hookean solid, and its shear relaxation by a Prony series."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.bulk.bulk_law import (
    PAIRS,
    BulkResponse,
    IsotropicLaw,
    cofactor,
    cofactor_derivative,
)


@dataclass(frozen=True)
class NeoHookean(IsotropicLaw):
    r"""Neo-Hookean elasticity, which is Hooke's law at small strain.

    Parameters
    ----------
    youngs_modulus : float, Young's modulus :math:`E > 0` of the undeformed body, Pa
    poissons_ratio : float
        Poisson's ratio :math:`-1 < \nu < 1/2` of the undeformed body, dimensionless.

    Notes
    -----
    With Lamé's parameters as in :class:`~multiscale.laws.bulk.Elastic` and :math:`J = \det F`,

    .. math:: P = \mu (F - F^{-T}) + \lambda \ln J\, F^{-T},    \tag{1}

    where the last term is :math:`U'(J)\,\partial J/\partial F` with
    :math:`U = \tfrac{\lambda}{2}\ln^2 J`.

    References
    ----------
    .. [1] J. Bonet and R. D. Wood, Nonlinear Continuum Mechanics for Finite Element Analysis,
       2nd ed., Cambridge University Press, 2008: the compressible neo-Hookean material.
    """

    def respond_shape(self, gradient: np.ndarray, state: np.ndarray) -> BulkResponse:
        """Evaluate mu (F - F^-T), Pa."""
        mu = self.shear_modulus
        cof = cofactor(gradient)
        J = np.sum(gradient[0] * cof[0], axis=0)
        inverse = cof / J  # F^-T
        # d(F^-T) = d(cof)/J - F^-T (F^-T : dF)
        change = cofactor_derivative(gradient) / J - inverse[:, :, None, None] * inverse
        tangent = -mu * change
        for i in range(3):
            for j in range(3):
                tangent[i, j, i, j] += mu
        return BulkResponse(mu * (gradient - inverse), tangent, state)


@dataclass(frozen=True)
class Prony(IsotropicLaw):
    r"""Finite linear viscoelasticity of a neo-Hookean solid.

    Parameters
    ----------
    youngs_modulus : float, instantaneous Young's modulus :math:`E > 0`, Pa
    poissons_ratio : float, instantaneous Poisson's ratio :math:`-1 < \nu < 1/2`, dimensionless
    weights : tuple of float
        Relaxing shares :math:`g_i > 0` of the shear modulus, dimensionless; their sum is below 1.
    times : tuple of float, relaxation times :math:`\tau_i > 0`, s
    time_step : float, default 0.0
        Time :math:`\Delta t \ge 0` from the committed to the new state, s; see :meth:`over`.

    Notes
    -----
    The second Piola-Kirchhoff stress :math:`S = \mu (I - C^{-1})` of the neo-Hookean solid, without
    its volumetric part, relaxes:

    .. math::
        S_s(t) = \int_0^t \Big(1 - \sum_i g_i \big(1 - e^{-(t-s)/\tau_i}\big)\Big)
        \dot S(s)\, ds. \tag{1}

    With :math:`S` linear in time within the step, :math:`x_i = \Delta t/\tau_i` and
    :math:`\beta_i = (1 - e^{-x_i})/x_i`, the branches :math:`Q_i` and the stress are

    .. math::
        Q_i = e^{-x_i} Q_i^n + g_i \beta_i (S - S^n), \qquad
        S_s = \Big(1 - \sum_i g_i\Big) S + \sum_i Q_i . \tag{2}

    The volume is elastic with Lamé's instantaneous :math:`\lambda`. The state is :math:`S^n` and
    the :math:`Q_i`, six rows each (11, 22, 33, 12, 23, 13), Pa.

    References
    ----------
    .. [1] J. C. Simo, Comput. Methods Appl. Mech. Eng. 60 (1987) 153-173,
       doi:10.1016/0045-7825(87)90107-1: the convolution and its recurrence.
    """

    weights: tuple[float, ...]
    times: tuple[float, ...]
    time_step: float = 0.0
    rate_dependent = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.weights) != len(self.times) or not self.weights:
            raise CaseError(
                f"give a weight for each relaxation time, got {len(self.weights)} weights and "
                f"{len(self.times)} times"
            )
        if not (min(self.weights) > 0.0 and sum(self.weights) < 1.0):
            raise CaseError(
                f"the weights of a Prony series must be positive and add up to less than 1, got "
                f"{self.weights}, in all {sum(self.weights):g}"
            )
        if not (min(self.times) > 0.0 and np.all(np.isfinite(self.times))):
            raise CaseError(f"relaxation times must be positive (s), got {self.times}")
        if not 0.0 <= self.time_step < np.inf:
            raise CaseError(f"time_step must not be negative (s), got {self.time_step:g}")

    @property
    def n_state(self) -> int:  # type: ignore[override]
        """Number of internal variables per point."""
        return 6 * (1 + len(self.times))

    @property
    def history(self) -> tuple[str, ...]:
        """Names of the internal variables of every point."""
        return "elastic stress", *(f"stress of the branch of {time:g} s" for time in self.times)

    @property
    def solid(self) -> NeoHookean:
        """Instantaneous solid."""
        return NeoHookean(self.youngs_modulus, self.poissons_ratio)

    def over(self, time_step: float) -> Self:
        """Return the law for a step of another duration, s."""
        return replace(self, time_step=time_step)

    @property
    def decay(self) -> np.ndarray:
        """Factors e^-x of (2), shape (branches,)."""
        return np.exp(-self.time_step / np.array(self.times))

    @property
    def uptake(self) -> np.ndarray:
        """Factors g beta of (2), shape (branches,)."""
        x = self.time_step / np.array(self.times)
        return np.array(self.weights) * np.where(x > 0.0, -np.expm1(-x) / np.where(x > 0, x, 1), 1)

    @property
    def share(self) -> float:
        """Factor of the elastic stress S in (2), 1 - sum g + sum g beta."""
        return float(1.0 - sum(self.weights) + self.uptake.sum())

    def frozen_stress(self, state: np.ndarray) -> np.ndarray:
        """Return the part of (2) from the committed state only, shape (6, ...), Pa."""
        branches = state.reshape(len(self.times) + 1, 6, *state.shape[1:])
        relaxed = np.tensordot(self.decay, branches[1:], 1)
        return np.asarray(relaxed - self.uptake.sum() * branches[0])

    def advance(self, state: np.ndarray, elastic_stress: np.ndarray) -> np.ndarray:
        """Return the state at the end of a step with the elastic stress S, shape (6, ...), Pa."""
        branches = state.reshape(len(self.times) + 1, 6, *state.shape[1:])
        change = elastic_stress - branches[0]
        rows = [elastic_stress]
        for decay, uptake, branch in zip(self.decay, self.uptake, branches[1:], strict=True):
            rows.append(decay * branch + uptake * change)
        return np.concatenate(rows)

    def respond_shape(self, gradient: np.ndarray, state: np.ndarray) -> BulkResponse:
        """Return the stress F S_s of (2), its tangent and the new state."""
        F = gradient
        elastic = self.solid.respond_shape(F, state[:0])
        # part from the committed state, a second Piola-Kirchhoff stress
        frozen = np.empty_like(F)
        for row, (i, j) in zip(self.frozen_stress(state), PAIRS, strict=True):
            frozen[i, j] = frozen[j, i] = row
        stress = self.share * elastic.stress + np.einsum("ik...,kj...->ij...", F, frozen)
        tangent = self.share * elastic.tangent
        for i in range(3):
            tangent[i, :, i, :] += frozen
        # new state: S = F^-1 P of the elastic solid
        inverse = np.moveaxis(np.linalg.inv(np.moveaxis(F, (0, 1), (-2, -1))), (-2, -1), (0, 1))
        second = np.einsum("ik...,kj...->ij...", inverse, elastic.stress)
        rows = np.stack([second[i, j] for i, j in PAIRS])
        return BulkResponse(stress, tangent, self.advance(state, rows))
