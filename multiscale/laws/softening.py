"""Softening of a quasi-brittle solid: stress against the opening of its crack."""

from dataclasses import dataclass

import numpy as np

from multiscale.errors import CaseError

LAST_SHARE = 1e-6  # stiffness of an element that has cracked through, over its first
LAST_STRESS = 1e-3  # stress of the last tooth over the strength

FINE = 4001  # points at which the energy of a law is summed


@dataclass(frozen=True, eq=False)
class Softening:
    """Stress that a crack transmits at its opening.

    Parameters
    ----------
    opening : ndarray, shape (n,), rising from 0, m
    stress : ndarray, shape (n,), falling from the tensile strength to 0, Pa
    """

    opening: np.ndarray
    stress: np.ndarray

    def __post_init__(self) -> None:
        w, s = np.array(self.opening, float), np.array(self.stress, float)
        if w.shape != s.shape or w.ndim != 1 or w.size < 2:
            raise CaseError(f"a crack has a stress for each opening, got {w.shape} and {s.shape}")
        if w[0] != 0.0 or np.any(w[1:] <= w[:-1]):
            raise CaseError(f"the openings of a crack must rise from 0 (m), got {w.tolist()}")
        if s[-1] != 0.0 or np.any(s[1:] >= s[:-1]):
            raise CaseError(f"the stresses of a crack must fall to 0 (Pa), got {s.tolist()}")
        object.__setattr__(self, "opening", w)
        object.__setattr__(self, "stress", s)

    @property
    def strength(self) -> float:
        """Tensile strength, Pa."""
        return float(self.stress[0])

    @property
    def fracture_energy(self) -> float:
        """Energy per area of the crack, J/m²."""
        return float(np.trapezoid(self.stress, self.opening))

    def teeth(
        self, youngs_modulus: float, width: float, count: int
    ) -> tuple[np.ndarray, np.ndarray]:
        r"""Approximate the law of an element by a sequence of elastic laws.

        Parameters
        ----------
        youngs_modulus : float, Pa
        width : float, width :math:`h` of the crack band, m: size of the element across the crack
        count : int, number of teeth

        Returns
        -------
        share : ndarray, shape (count + 1,)
            Stiffness over the first stiffness, falling from 1 to a broken element.
        strength : ndarray, shape (count + 1,)
            Tension at which the next share follows, Pa; infinite at the last.

        Notes
        -----
        The crack is smeared over the band, :math:`\varepsilon = \sigma/E + w(\sigma)/h`, so that
        the energy per area of crack does not depend on h [1]_. Between two points of the law, which
        have the secants :math:`r_k E = \sigma_k/\varepsilon_k`, a straight line dissipates

        .. math:: \frac{h}{2E}\, \sigma_k \sigma_{k+1} (1/r_{k+1} - 1/r_k)
            = \tfrac12 (\sigma_k w_{k+1} - \sigma_{k+1} w_k),    \tag{1}

        also where the strain falls because the band is wide. The points divide the energy equally,
        and the stress of the last point is a thousandth of the strength.

        References
        ----------
        .. [1] Z. P. Bazant and B. H. Oh, Mater. Struct. 16 (1983) 155-177, doi:10.1007/BF02486267.
        """
        end = np.interp(-LAST_STRESS * self.strength, -self.stress, self.opening)
        w = np.unique(np.append(np.linspace(0.0, end, FINE), self.opening[self.opening < end]))
        s = np.interp(w, self.opening, self.stress)
        energy = np.append(0.0, np.cumsum(0.5 * (s[:-1] * w[1:] - s[1:] * w[:-1])))
        at = np.interp(np.linspace(0.0, 1.0, count), energy / energy[-1], w)
        stress = np.interp(at, self.opening, self.stress)
        share = 1.0 / (1.0 + youngs_modulus * at / (width * stress))
        return np.append(share, LAST_SHARE), np.append(stress, np.inf)
