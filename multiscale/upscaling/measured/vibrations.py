"""Vibrations of a mass on a joint or of a structure, as measured values of the law."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import ClassVar

import numpy as np

from multiscale.errors import CaseError
from multiscale.upscaling.budget import NORMAL
from multiscale.upscaling.measured.joints import Answer, BedCurve, MeasuredJoint, MeasuredLoop
from multiscale.upscaling.measured.readers import refuse_settings, usual_nuisances
from multiscale.upscaling.tables import read_columns, units_of_columns

COLUMNS = {"amplitude": "m", "frequency": "s-1", "damping": "1"}
ERRORS = ("frequency error", "damping error")
"""Columns of a table of vibrations, with units, and columns of errors, over the values."""

NODES, WEIGHTS = (each / 2.0 for each in np.polynomial.legendre.leggauss(40))
ANGLES = np.pi * (0.5 + NODES)
"""Angles of half a cycle, and their weights in its mean."""

SHARES = {"damping": 1.0, ERRORS[0]: 0.5, ERRORS[1]: 1.0}
"""Limits of columns of shares; a damping ratio of 1 allows no vibration."""


Structure = Callable[[np.ndarray], tuple[float, np.ndarray, Answer]]
"""Maps amplitudes, m, to the mean pressure of the joints, Pa, to half-widths of the answers by the
structure, and to the answer of a table: first the frequencies, s⁻¹, then the damping ratios."""


class _Vibration(MeasuredJoint):
    """Frequencies, then damping ratios."""

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Names and units of frequencies and damping ratios, by the rows of the table."""
        listed = range(1, self.value.size // 2 + 1)
        quantities = {"frequency": "s-1", "damping": "1"}
        return [(f"{name} of row {k}", unit) for name, unit in quantities.items() for k in listed]


@dataclass(frozen=True, eq=False)
class MeasuredVibration(_Vibration, MeasuredLoop):
    r"""Frequency, s⁻¹, then damping ratio, of tangential vibrations at constant preloads.

    A mass m over the nominal area at its phase resonance, of the frequency f without damping and
    the damping ratio :math:`\zeta`, has the first harmonic of the shear of a closed loop, with the
    first loading B of :class:`MeasuredLoop` at :math:`a \sin^2(\theta/2)` and the work
    :math:`\pi a^2 k''`,

    .. math::
        k' = m (2 \pi f)^2 = -\frac{4}{\pi a} \int_0^\pi B \cos\theta\, \mathrm{d}\theta, \qquad
        k'' = 2 \zeta k' =
        \frac{4}{\pi a} \Bigl( \int_0^\pi B \sin\theta\, \mathrm{d}\theta - B(a) \Bigr).    \tag{1}
    """

    mass: float = field(kw_only=True)  # kg/m²

    @cached_property
    def _branches(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Amplitudes and pressures of first loadings, and their sums (1): k', then k''."""
        n = self.value.size // 2
        a, p = self.displacement[:n], self.pressure[:n]
        each = np.eye(n)
        cosine, sine = (
            np.repeat(each, ANGLES.size, axis=1) * np.tile(WEIGHTS * part(ANGLES), n)
            for part in (np.cos, np.sin)
        )
        matrix = np.block([[0.0 * each, -cosine], [-each / np.pi, sine]])
        matrix *= 4.0 / np.tile(a, 2)[:, None]
        amplitude = np.concatenate([a, np.outer(a, np.sin(0.5 * ANGLES) ** 2).ravel()])
        return amplitude, np.concatenate([p, np.repeat(p, ANGLES.size)]), matrix

    def answer(
        self, interface: BedCurve, nuisances: Mapping[str, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate frequency and damping."""
        (k, loss), (by_k, by_loss) = (
            np.split(each, 2) for each in super().answer(interface, nuisances)
        )
        frequency, damping = np.sqrt(k / self.mass) / (2.0 * np.pi), 0.5 * loss / k
        rates = (
            (0.5 * frequency / k)[:, None] * by_k,
            (0.5 * by_loss - damping[:, None] * by_k) / k[:, None],
        )
        return np.append(frequency, damping), np.vstack(rates)


@dataclass(frozen=True, eq=False)
class MeasuredModes(_Vibration):
    """Frequency and damping ratio of a structure, by a solve of it; see :func:`read_vibration`."""

    solve: Answer = field(kw_only=True)

    sheared: ClassVar[bool] = True
    linear: ClassVar[bool] = True

    def answer(
        self, interface: BedCurve, nuisances: Mapping[str, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate frequency and damping."""
        return self.solve(self, interface, nuisances)


def read_vibration(
    path: str | PathLike[str],
    *,
    mass: float | None = None,
    structure: Structure | None = None,
    error: float | None = None,
    bodies: float = 0.0,
    frame: float | None = None,
    offset: float | None = None,
) -> MeasuredVibration | MeasuredModes:
    r"""Read measured vibrations of a mass on a joint, or of a structure, with units in the head.

    Parameters
    ----------
    path : path
        A table with the columns ``preload``, over the nominal area, ``amplitude``, of the
        tangential displacement, ``frequency``, of phase resonance (of a free decay over
        :math:`\sqrt{1 - \zeta^2}`), and ``damping``, the ratio to critical damping, all of it by
        friction of the joint; and ``frequency error`` and ``damping error``, half-widths of 95 %
        intervals over the values.
    mass : float, optional, that vibrates, over the nominal area, kg/m²
    structure : callable, optional, in place of ``mass``
        Maps amplitudes, m, to the mean pressure of the joints of a structure, Pa, to half-widths
        of the 95 % intervals of its frequencies, s⁻¹, then of its damping ratios, by its
        discretisation, and to a function of both with the arguments and the result of
        :meth:`MeasuredJoint.answer`. Its table has no ``preload``, and amplitudes as the structure
        has them.
    error : float, optional, half-width of frequency and damping, without these columns
    bodies, frame, offset : float, optional; see :func:`~.tables.read_measured`

    Raises
    ------
    CaseError
        If the table is refused, has no error, or has a damping of 1 or more.
    """
    path = Path(path)
    refuse_settings(path, error, {"bodies": bodies, "frame": frame, "offset": offset})
    if (mass is None) == (structure is None):
        raise CaseError(f"{path}: vibrations need either a mass or a structure; give one of them")
    if mass is not None and not 0.0 < mass < np.inf:
        raise CaseError(f"{path}: mass must be positive (kg/m^2), got {mass:g}; correct it")
    given = [name for name in ERRORS if name in units_of_columns(path)]
    if (len(given) == len(ERRORS)) == (error is not None) or len(given) == 1:
        raise CaseError(
            f'{path}: vibrations need either error, such as "3 %", or both columns '
            f"{' and '.join(ERRORS)}, got {' and '.join(given) or 'no such column'} and "
            f"error = {error}"
        )
    preload = {} if mass is None else {"preload": "Pa"}
    columns, _, _ = read_columns(path, preload | COLUMNS | dict.fromkeys(given, "1"), signed=())
    a, frequency, damping = (columns[name] for name in COLUMNS)
    of_frequency, of_damping = (columns.get(name, np.full(a.size, error)) for name in ERRORS)
    if error is not None and error >= SHARES[ERRORS[0]]:
        raise CaseError(
            f"{path}: the error of {error:g} of frequency and damping is not below "
            f"{SHARES[ERRORS[0]]:g}; state a smaller error, or columns {' and '.join(ERRORS)}"
        )
    for name in ("damping", *given):
        values, most = columns[name], SHARES[name]
        if (above := np.flatnonzero(values >= most)).size:
            raise CaseError(
                f"{path}, row {above[0] + 1}: the {name} of {values[above[0]]:.4g} is not below "
                f"{most:g}; give it as a share, or with its unit, such as {name} (%)"
            )
    value = np.concatenate([frequency, damping])
    half = value * np.concatenate([of_frequency, of_damping])
    if structure is not None:
        mean, of_structure, solve = structure(a)
        loads, half = np.full(value.size, mean), np.hypot(half, of_structure)
        return MeasuredModes(path.name, loads, value, half / NORMAL, {}, solve=solve)
    assert mass is not None  # as checked
    pressure, stiffness = np.tile(columns["preload"], 2), mass * (2.0 * np.pi * frequency) ** 2
    nuisances = usual_nuisances(frame, offset, 1.0 / stiffness, pressure)
    given_values = (path.name, pressure, value, half / NORMAL, nuisances, bodies)
    return MeasuredVibration(*given_values, displacement=np.tile(a, 2), mass=mass)
