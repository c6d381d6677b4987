"""Rubber: a compressible neo-Hookean solid, and its shear relaxation by a Prony series."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from multiscale.errors import CaseError, require
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
        require("time_step", self.time_step, "[0, inf)", "s")

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


MAX_ITERATIONS = 60
"""Limit of Newton steps of the return mapping, which converges since hardening is concave."""


@dataclass(frozen=True)
class J2(IsotropicLaw):
    r"""J2 plasticity in logarithmic strain.

    Parameters
    ----------
    youngs_modulus : float, Young's modulus :math:`E > 0`, Pa
    poissons_ratio : float, Poisson's ratio :math:`-1 < \nu < 1/2`, dimensionless
    yield_stress : float, initial uniaxial yield stress :math:`\sigma_0 > 0` (Kirchhoff), Pa
    hardening_modulus : float, default 0.0, linear hardening :math:`H \ge 0`, Pa
    saturation_stress : float, optional
        Saturated yield stress :math:`\sigma_\infty \ge \sigma_0`, Pa; the initial yield stress if
        not given.
    saturation_rate : float, default 0.0, rate :math:`\delta \ge 0` of saturation, dimensionless

    Notes
    -----
    With the trial :math:`b = F C_p^{-1} F^T = \sum_a b_a\, n_a \otimes n_a`, the elastic
    logarithmic strains :math:`\varepsilon_a = \tfrac12 \ln b_a` and their deviator :math:`e_a`,
    the principal Kirchhoff stresses follow from the small-strain return mapping,

    .. math::
        s_a &= 2\mu\, (e_a - \Delta\gamma\, N_a), \qquad N = e / |e|, \tag{1} \\
        |s| &\le \sqrt{2/3}\,\sigma_y(\alpha), \qquad
        \alpha = \alpha_n + \sqrt{2/3}\,\Delta\gamma, \tag{2} \\
        \sigma_y(\alpha) &= \sigma_0 + H \alpha
        + (\sigma_\infty - \sigma_0)(1 - e^{-\delta\alpha}), \tag{3}

    and :math:`P_s = s F^{-T}`. The volume is elastic, :math:`U = \tfrac{K}{2} \ln^2 J`. The state
    is :math:`C_p^{-1} - I` (rows 11, 22, 33, 12, 23, 13) and the accumulated plastic strain
    :math:`\alpha`.

    References
    ----------
    .. [1] J. C. Simo, Comput. Methods Appl. Mech. Eng. 99 (1992) 61-112,
       doi:10.1016/0045-7825(92)90123-2: return mapping in principal logarithmic strains.
    """

    yield_stress: float
    hardening_modulus: float = 0.0
    saturation_stress: float | None = None
    saturation_rate: float = 0.0
    n_state = 7
    flows = True

    def __post_init__(self) -> None:
        super().__post_init__()
        require("yield_stress", self.yield_stress, "(0, inf)", "Pa")
        for name, unit in (("hardening_modulus", "Pa"), ("saturation_rate", "1")):
            if not 0.0 <= getattr(self, name) < np.inf:
                raise CaseError(
                    f"{name} must not be negative ({unit}), because a metal that softens localises "
                    f"in bands one element wide; got {getattr(self, name):g}"
                )
        if not self._saturation() >= self.yield_stress:
            raise CaseError(
                f"saturation_stress must be at least the yield_stress {self.yield_stress:g} Pa, "
                f"got {self._saturation():g}"
            )

    @property
    def history(self) -> tuple[str, ...]:
        """Names of the internal variables of every point."""
        return "plastic metric C_p^-1", "accumulated plastic strain"

    @property
    def volume_modulus(self) -> float:
        """Factor of the volume energy, Pa: the bulk modulus."""
        return self.youngs_modulus / (3.0 * (1.0 - 2.0 * self.poissons_ratio))

    def respond_shape(self, gradient: np.ndarray, state: np.ndarray) -> BulkResponse:
        """Evaluate the return mapping (1)-(3) with its exact spectral tangent and the new state."""
        points = gradient.shape[2:]
        F = np.moveaxis(gradient.reshape(3, 3, -1), 2, 0)
        Cp = np.empty(F.shape)
        for row, (i, j) in zip(state.reshape(7, -1), PAIRS, strict=False):
            Cp[:, i, j] = Cp[:, j, i] = row + float(i == j)
        b, n = np.linalg.eigh(F @ Cp @ F.swapaxes(1, 2))
        strain = 0.5 * np.log(b)
        s, ds, flow, alpha = self._return_map(strain, state.reshape(7, -1)[6])

        inverse = np.linalg.inv(F)
        tau = (n * s[:, None, :]) @ n.swapaxes(1, 2)
        stress = tau @ inverse.swapaxes(1, 2)
        tangent = _spectral_tangent(F, Cp, inverse, (b, n, s, ds), stress)

        # C_p^-1 = F^-1 b_e F^-T with the elastic strains after the return
        elastic = (n * np.exp(2.0 * (strain - flow))[:, None, :]) @ n.swapaxes(1, 2)
        new = inverse @ elastic @ inverse.swapaxes(1, 2)
        # elastic points keep their state exactly
        new = np.where(np.any(flow != 0.0, axis=1)[:, None, None], new, Cp) - np.eye(3)
        state_new = np.stack([*(new[:, i, j] for i, j in PAIRS), alpha])
        return BulkResponse(
            np.moveaxis(stress, 0, 2).reshape(3, 3, *points),
            np.moveaxis(tangent, 0, 4).reshape(3, 3, 3, 3, *points),
            state_new.reshape(7, *points),
        )

    def flow_stress(self, plastic_strain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the yield stress (3) and its derivative, Pa, at an accumulated plastic strain."""
        rise = self._saturation() - self.yield_stress
        decay = np.exp(-self.saturation_rate * plastic_strain)
        stress = self.yield_stress + self.hardening_modulus * plastic_strain + rise * (1.0 - decay)
        return stress, self.hardening_modulus + rise * self.saturation_rate * decay

    @property
    def hardening(self) -> tuple[float, float, float, float]:
        """Initial yield stress, hardening modulus and rise to saturation, Pa, and its rate."""
        rise = self._saturation() - self.yield_stress
        return self.yield_stress, self.hardening_modulus, rise, self.saturation_rate

    def _saturation(self) -> float:
        return self.yield_stress if self.saturation_stress is None else self.saturation_stress

    def _return_map(
        self, strain: np.ndarray, alpha: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return principal s, ds/d(strain), flow and alpha for trial strains (points, 3)."""
        mu = self.shear_modulus
        deviator = np.eye(3) - 1.0 / 3.0
        e = strain @ deviator
        size = np.sqrt(np.sum(e**2, axis=1))
        gamma = np.zeros_like(size)
        plastic = 2.0 * mu * size > np.sqrt(2.0 / 3.0) * self.flow_stress(alpha)[0]
        for _ in range(MAX_ITERATIONS if plastic.any() else 0):
            stress, slope = self.flow_stress(alpha + np.sqrt(2.0 / 3.0) * gamma)
            excess = 2.0 * mu * (size - gamma) - np.sqrt(2.0 / 3.0) * stress  # (2)
            step = np.where(plastic, excess / (2.0 * mu + 2.0 / 3.0 * slope), 0.0)
            gamma = gamma + step
            if not np.any(np.abs(step) > 1e-15 * size):
                break
        slope = self.flow_stress(alpha + np.sqrt(2.0 / 3.0) * gamma)[1]
        safe = np.where(size > 0.0, size, 1.0)
        N = e / safe[:, None]
        flow = gamma[:, None] * N
        s = 2.0 * mu * (e - flow)  # (1)
        share = np.where(plastic, 2.0 * mu / (2.0 * mu + 2.0 / 3.0 * slope), 0.0)  # dgamma/d|e|
        ratio = gamma / safe
        radial = (share - ratio)[:, None, None] * N[:, :, None] * N[:, None, :]
        ds = 2.0 * mu * ((1.0 - ratio)[:, None, None] * deviator - radial)
        return s, ds, flow, alpha + np.sqrt(2.0 / 3.0) * gamma


def _spectral_tangent(
    F: np.ndarray,
    Cp: np.ndarray,
    inverse: np.ndarray,
    spectrum: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    stress: np.ndarray,
) -> np.ndarray:
    """Return the derivative of s F^-T by F, shape (points, 3, 3, 3, 3), Pa."""
    b, n, s, ds = spectrum
    # coefficients of d(tau) in the principal frame of b: ds_a = ds_ab (1/2b_b) db_bb
    direct = ds / (2.0 * b[:, None, :])
    gap = b[:, :, None] - b[:, None, :]
    close = np.abs(gap) <= 1e-6 * (b[:, :, None] + b[:, None, :])
    equal = 0.5 * (np.einsum("paa->pa", direct)[:, :, None] + np.einsum("pbb->pb", direct)[:, None])
    cross = 0.5 * (direct + direct.swapaxes(1, 2))
    shear = np.where(
        close, equal - cross, (s[:, :, None] - s[:, None, :]) / np.where(close, 1.0, gap)
    )
    # db for every unit change of F, (points, kl, 3, 3): e_k x (F C_p^-1)_l and its transpose
    G = (F @ Cp).swapaxes(1, 2)
    db = np.einsum("ik,plj->pklij", np.eye(3), G).reshape(-1, 9, 3, 3)
    db = db + db.swapaxes(2, 3)
    R = n[:, None]
    principal = R.swapaxes(2, 3) @ db @ R
    change = shear[:, None] * principal
    diagonal = np.einsum("pab,pmbb->pma", direct, principal)
    for a in range(3):
        change[:, :, a, a] = diagonal[:, :, a]
    dtau = R @ change @ R.swapaxes(2, 3)
    tangent = (dtau @ inverse[:, None].swapaxes(2, 3)).reshape(-1, 3, 3, 3, 3)  # p, k, l, i, j
    # - s F^-T dF^T F^-T: stress_il inverse_jk... d(F^-T)_mj = -F^-T_ml dF_kl F^-T_kj
    tangent = tangent - np.einsum("pil,pjk->pklij", stress, inverse)
    return np.asarray(np.moveaxis(tangent, (3, 4), (1, 2)))
