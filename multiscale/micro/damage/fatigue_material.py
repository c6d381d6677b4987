"""Material of two-scale fatigue, and the layout of its arrays."""

from dataclasses import dataclass, fields

import numpy as np

from multiscale.errors import CaseError

__all__ = ["STATE_SIZE", "FatigueMaterial"]

STATE_SIZE = 20
"""Length of the state: D, p, plastic strain (6), back stress (6, Pa), last macro stress (6, Pa)."""

# places of the parameters in the array of a material, as the fields of FatigueMaterial
E, NU, LIMIT, STRENGTH, EXPONENT, HARDENING, THRESHOLD, CRITICAL, CLOSURE, FEEDBACK = range(10)


@dataclass(frozen=True)
class FatigueMaterial:
    r"""Elastic volume and micro-inclusion; see :mod:`~multiscale.micro.damage.inclusion`.

    Parameters
    ----------
    youngs_modulus, poissons_ratio : float, moduli of volume and inclusion, Pa and dimensionless
    fatigue_limit : float
        :math:`\sigma_f`, yield stress of the inclusion, Pa.
    damage_strength : float
        :math:`S` of the damage law, Pa.
    damage_exponent : float
        :math:`s`, dimensionless.
    hardening : float, kinematic modulus :math:`C`, Pa
    threshold : float
        Plastic strain :math:`p_D` of the inclusion at which damage begins, dimensionless.
    critical_damage : float
        :math:`D_c` at which a crack starts, dimensionless, above 0 and up to 1.
    closure : float
        :math:`h`, share of the damage that acts in compression, 0 to 1.
    feedback : bool
        Whether damage changes the stress of the inclusion. Without it the model has a closed
        form for reversed tension.
    """

    youngs_modulus: float
    poissons_ratio: float
    fatigue_limit: float
    damage_strength: float
    damage_exponent: float = 1.0
    hardening: float = 0.0
    threshold: float = 0.0
    critical_damage: float = 0.3
    closure: float = 1.0
    feedback: bool = True

    def __post_init__(self) -> None:
        for name, unit in (
            ("youngs_modulus", "Pa"),
            ("fatigue_limit", "Pa"),
            ("damage_strength", "Pa"),
            ("damage_exponent", "dimensionless"),
        ):
            value = getattr(self, name)
            if not (value > 0.0 and np.isfinite(value)):
                raise CaseError(f"{name} must be positive ({unit}), got {value:g}")
        for name, unit in (("hardening", "Pa"), ("threshold", "dimensionless")):
            value = getattr(self, name)
            if not (value >= 0.0 and np.isfinite(value)):
                raise CaseError(f"{name} must not be negative ({unit}), got {value:g}")
        if not -1.0 < self.poissons_ratio < 0.5:
            raise CaseError(
                f"poissons_ratio must lie between -1 and 0.5, got {self.poissons_ratio:g}"
            )
        if not 0.0 < self.critical_damage <= 1.0:
            raise CaseError(
                f"critical_damage must lie above 0 and up to 1, got {self.critical_damage:g}"
            )
        if not 0.0 <= self.closure <= 1.0:
            raise CaseError(f"closure must lie from 0 to 1, got {self.closure:g}")

    def parameters(self) -> np.ndarray:
        """Return the parameters in SI units, in the order of the fields and of the kernel."""
        return np.array([float(getattr(self, field.name)) for field in fields(self)])
