"""Material and stress blocks of two-scale fatigue."""

from dataclasses import dataclass, fields

import numpy as np

from multiscale.errors import CaseError

__all__ = ["STATE_SIZE", "FatigueMaterial", "StressBlock"]

STATE_SIZE = 20
"""Length of the state: D, p, plastic strain (6), back stress (6, Pa), last macro stress (6, Pa)."""

# places of the parameters in the array of a material, as the fields of FatigueMaterial
E, NU, LIMIT, STRENGTH, EXPONENT, HARDENING, THRESHOLD, CRITICAL, CLOSURE, FEEDBACK = range(10)

TRACE = 1e-9
"""Trace of a plastic strain over its largest component that is rounding."""


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

    Raises
    ------
    CaseError
        If a parameter is outside its range.
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

    def driving_stress(self, stress: np.ndarray, plastic_strain: np.ndarray) -> np.ndarray:
        r"""Return the stress that drives the inclusion of an elastic volume as this one does.

        Parameters
        ----------
        stress : ndarray, shape (points, 6)
            Corners of a path of the macro stress, Pa: xx, yy, zz, yz, xz, xy.
        plastic_strain : ndarray, shape (points, 6)
            Plastic strain :math:`\varepsilon^p` of the volume at the corners, without a trace and
            with shear angles; corners are joined by straight lines, so that there is one wherever
            the volume begins to yield.

        Returns
        -------
        ndarray, shape (points, 6)
            :math:`\sigma + 2G(1-b)\, \varepsilon^p`, Pa: the strain of an elastic-plastic volume
            is :math:`E^{-1} : \sigma + \varepsilon^p`, of which its inclusion takes
            :math:`(1-b)\, \varepsilon^p / (1-bD)` for every D.

        Raises
        ------
        CaseError
            If the shapes differ or the plastic strain changes the volume.
        """
        strain = np.asarray(plastic_strain, dtype=float)
        if strain.shape != np.shape(stress) or strain.ndim != 2 or strain.shape[1] != 6:
            raise CaseError(
                f"stress and plastic_strain have the shape (points, 6), got {np.shape(stress)} and "
                f"{strain.shape}"
            )
        if np.any(np.abs(strain[:, :3].sum(axis=1)) > TRACE * np.abs(strain).max()):
            raise CaseError("a plastic strain keeps the volume, and plastic_strain has a trace")
        nu = self.poissons_ratio
        b = 2.0 * (4.0 - 5.0 * nu) / (15.0 * (1.0 - nu))
        tensor = strain * np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])
        return np.asarray(stress + self.youngs_modulus / (1.0 + nu) * (1.0 - b) * tensor)

    def parameters(self) -> np.ndarray:
        """Return the parameters in SI units, in the order of the fields and of the kernel."""
        return np.array([float(getattr(self, one.name)) for one in fields(self)])


@dataclass(frozen=True)
class StressBlock:
    """A closed stress path that is repeated.

    Parameters
    ----------
    stress : ndarray, shape (points,) or (points, 6)
        Corners of one cycle, joined by straight lines, Pa: uniaxial stress, or xx, yy, zz, yz,
        xz, xy.
    cycles : int

    Raises
    ------
    CaseError
        If a stress is not finite or there are no cycles.
    """

    stress: np.ndarray
    cycles: int = 1

    def __post_init__(self) -> None:
        stress = np.asarray(self.stress, dtype=float)
        if stress.ndim == 1:
            stress = stress[:, None] * np.eye(6)[0]
        if stress.ndim != 2 or stress.shape[1] != 6 or len(stress) == 0:
            raise CaseError(
                f"the stress of a block needs the shape (points,) or (points, 6), "
                f"got {np.shape(self.stress)}"
            )
        if not np.all(np.isfinite(stress)):
            raise CaseError("the stress of a block must be finite (Pa)")
        if self.cycles < 1:
            raise CaseError(f"a block needs at least one cycle, got {self.cycles}")
        object.__setattr__(self, "stress", np.ascontiguousarray(stress))
