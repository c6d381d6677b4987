"""Base class of bulk laws; tensors have the order xx, yy, zz, yz, xz, xy.

Tangents have the shape (6, 6), Pa, for strains with shear angles (twice the tensor shears).
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from multiscale.errors import CaseError

PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
"""Components of a symmetric matrix in the rows of a state."""


@dataclass(frozen=True)
class BulkResponse:
    r"""Response of a bulk law.

    Attributes
    ----------
    stress : ndarray, shape (3, 3, ...), First Piola-Kirchhoff stress :math:`P`, Pa
    tangent : ndarray, shape (3, 3, 3, 3, ...)
        :math:`A_{ijkl} = \partial P_{ij} / \partial F_{kl}`, Pa.
    state : ndarray, shape (n_state, ...), new internal variables, with the units of the law
    """

    stress: np.ndarray
    tangent: np.ndarray
    state: np.ndarray


class BulkLaw(ABC):
    r"""Maps a deformation gradient to a stress, pointwise.

    The stress is the sum of the response to the change of shape and to the change of volume,

    .. math:: P = P_s(F, \text{state}) + U'(J)\, \partial J / \partial F,    \tag{1}

    so that an element can use its mean volume change :math:`J`, which avoids locking. Arrays have
    their component axes first, any axes may follow. The state is an argument and a result; a law
    stores nothing between calls. Plane strain is :math:`F_{33} = 1`.

    Attributes
    ----------
    n_state : int, number of internal variables per point
    finite_strain : bool
        Whether :math:`J = \det F`. Otherwise the law is linear, :math:`J = \mathrm{tr} F - 2`.
    flows : bool
        Whether the shape changes permanently at constant volume: elements then take the change
        of volume from its mean, and increments are short.
    rate_dependent : bool, whether the stress depends on the strain rate
    """

    n_state: int = 0
    finite_strain: bool = True
    flows: bool = False
    rate_dependent: bool = False

    @property
    def history(self) -> tuple[str, ...]:
        """Names of the internal variables of every point; empty for an elastic law."""
        return ()

    @abstractmethod
    def respond_shape(self, gradient: np.ndarray, state: np.ndarray) -> BulkResponse:
        """Return :math:`P_s`, Pa, its tangent and the new state for F of shape (3, 3, ...)."""

    @abstractmethod
    def respond_volume(self, dilatation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives U' and U'', Pa, at a volume ratio J, dimensionless."""

    def initial_state(self, shape: tuple[int, ...]) -> np.ndarray:
        """Return the state of the undeformed body, shape (n_state, *shape)."""
        return np.zeros((self.n_state, *shape))


@dataclass(frozen=True)
class IsotropicLaw(BulkLaw):
    r"""Law of an isotropic solid with the volume energy :math:`\tfrac12 K_v \ln^2 J`, J/m³."""

    youngs_modulus: float  # of the undeformed body, Pa
    poissons_ratio: float  # from -1 to 1/2

    def __post_init__(self) -> None:
        check_moduli(self.youngs_modulus, self.poissons_ratio)

    @property
    def shear_modulus(self) -> float:
        """Shear modulus, Pa."""
        return float(lame_parameters(self.youngs_modulus, self.poissons_ratio)[1])

    @property
    def volume_modulus(self) -> float:
        """Factor of the volume energy, Pa: Lamé's first parameter, unless a law overrides it."""
        return float(lame_parameters(self.youngs_modulus, self.poissons_ratio)[0])

    def respond_volume(self, dilatation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return U' and U'' of the volume energy, Pa."""
        log, K = np.log(dilatation), self.volume_modulus
        return K * log / dilatation, K * (1.0 - log) / dilatation**2


def respond_bulk(law: BulkLaw, gradient: np.ndarray, state: np.ndarray) -> BulkResponse:
    """Evaluate both parts (1) of a law for deformation gradients, shape (3, 3, ...)."""
    shape = law.respond_shape(gradient, state)
    J, slope = volume_ratio(law, gradient)
    first, curvature = law.respond_volume(J)
    tangent = shape.tangent + curvature * slope[:, :, None, None] * slope
    if law.finite_strain:
        tangent = tangent + first * cofactor_derivative(gradient)
    return BulkResponse(shape.stress + first * slope, tangent, shape.state)  # (1)


def volume_ratio(law: BulkLaw, gradient: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return J of a law, dimensionless, and its derivative by F, shape (3, 3, ...)."""
    if law.finite_strain:
        slope = cofactor(gradient)
        return np.sum(gradient[0] * slope[0], axis=0), slope
    slope = np.zeros_like(gradient)
    slope[0, 0] = slope[1, 1] = slope[2, 2] = 1.0
    return np.trace(gradient) - 2.0, slope


def cofactor(gradient: np.ndarray) -> np.ndarray:
    """Return the derivative of det F, the cofactor matrix J F^-T, shape (3, 3, ...)."""
    F = gradient
    return np.stack(
        [
            np.stack(
                [
                    F[(i + 1) % 3, (j + 1) % 3] * F[(i + 2) % 3, (j + 2) % 3]
                    - F[(i + 1) % 3, (j + 2) % 3] * F[(i + 2) % 3, (j + 1) % 3]
                    for j in range(3)
                ]
            )
            for i in range(3)
        ]
    )


def cofactor_derivative(gradient: np.ndarray) -> np.ndarray:
    """Return the second derivative of det F, e_ikm e_jln F_mn, shape (3, 3, 3, 3, ...)."""
    second = np.zeros((3, 3, *gradient.shape))
    for i in range(3):
        for j in range(3):
            i1, i2, j1, j2 = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            second[i, j, i1, j1] = gradient[i2, j2]
            second[i, j, i2, j2] = gradient[i1, j1]
            second[i, j, i1, j2] = -gradient[i2, j1]
            second[i, j, i2, j1] = -gradient[i1, j2]
    return second


MANDEL = np.array([1.0, 1.0, 1.0, 2.0**0.5, 2.0**0.5, 2.0**0.5])
"""Factors between the components and an orthonormal basis of symmetric tensors."""

VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
"""Indices of the components xx, yy, zz, yz, xz, xy."""


def check_moduli(
    youngs_modulus: float | np.ndarray, poissons_ratio: float | np.ndarray, least: float = -1.0
) -> None:
    """Refuse a Young's modulus or a Poisson's ratio outside its range."""
    E, nu = np.ravel(youngs_modulus), np.ravel(poissons_ratio)
    wrong = E[~((E > 0.0) & np.isfinite(E))]
    if wrong.size:
        raise CaseError(f"youngs_modulus must be positive (Pa), got {wrong[0]:g}")
    wrong = nu[~((nu > -1.0) & (nu >= least) & (nu < 0.5))]
    if wrong.size:
        raise CaseError(
            f"poissons_ratio must lie between {least:g} and 0.5, got {wrong[0]:g}; use 0.499 for "
            f"an incompressible material"
        )


def contact_modulus(*bodies: tuple[float, float]) -> float:
    r"""Return the contact modulus, Pa, of bodies (E, nu): :math:`1/E^* = \sum (1-\nu_i^2)/E_i`.

    Examples
    --------
    >>> round(contact_modulus((210e9, 0.3), (210e9, 0.3)) / 1e9, 3)
    115.385
    """
    return 1.0 / sum((1.0 - nu**2) / modulus for modulus, nu in bodies)


def lame_parameters(
    youngs_modulus: float | np.ndarray, poissons_ratio: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    r"""Return Lamé's parameters :math:`\lambda` and :math:`\mu`, Pa."""
    E, nu = np.asarray(youngs_modulus), np.asarray(poissons_ratio)
    return E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), E / (2.0 * (1.0 + nu))


def mindlin_ratio(poissons_ratio: float) -> float:
    """Tangential over normal stiffness of contacts between alike bodies, by Mindlin."""
    return 2.0 * (1.0 - poissons_ratio) / (2.0 - poissons_ratio)


def youngs_modulus_along(stiffness: np.ndarray, normals: np.ndarray) -> np.ndarray:
    r"""Young's modulus, Pa, for tension along unit vectors n, shape (..., 3).

    :math:`1 / (n \otimes n : C^{-1} : n \otimes n)`; zero where nothing resists the tension.
    """
    n = np.asarray(normals, dtype=float)
    tension = MANDEL * np.stack([n[..., i] * n[..., j] for i, j in VOIGT], axis=-1)
    values, modes = np.linalg.eigh(MANDEL[:, None] * stiffness * MANDEL)
    share = (tension @ modes) ** 2
    lost = values <= 1e-9 * max(values.max(), 0.0)
    compliance = share[..., ~lost] @ (1.0 / values[~lost])
    resisted = share[..., lost].sum(axis=-1) < 1e-9
    return np.asarray(np.where(resisted, 1.0 / np.where(resisted, compliance, 1.0), 0.0))


def drop_soft_modes(stiffness: np.ndarray, limit: float) -> np.ndarray:
    """Remove the modes of strain that are softer than a limit, Pa; without any, change nothing."""
    values, modes = np.linalg.eigh(MANDEL[:, None] * stiffness * MANDEL)
    if not np.any(values < limit):
        return stiffness
    stiff = (modes * np.where(values < limit, 0.0, values)) @ modes.T
    return np.asarray(stiff / MANDEL / MANDEL[:, None])
