r"""Biaxial compression of a representative volume of grains, and its response."""

from dataclasses import replace

import numpy as np

from multiscale.errors import CaseError, ConvergenceError
from multiscale.macro.granulate.grain_bodies import Grains
from multiscale.macro.granulate.grain_cells import compact, resolving_step
from multiscale.macro.granulate.model import ContactLaw, Model, Solver
from multiscale.schema import Dataset

__all__ = ["biaxial_cell", "biaxial_curve"]


def biaxial_cell(
    radii: np.ndarray,
    pressure: float,
    strain_rate: float,
    law: ContactLaw,
    *,
    planar: bool = False,
    density: float = 2600.0,
    solver: Solver | None = None,
    seed: int = 0,
) -> tuple[Model, float]:
    r"""Grains in a periodic cell that bears a pressure and is about to be shortened along z.

    Parameters
    ----------
    radii, law, planar, density, seed
        As for :func:`compact`.
    pressure : float
        Pressure of the isotropic compaction, and on the sides of the cell during the test, Pa. In a
        cell of spheres it is the mean of the two lateral stresses.
    strain_rate : float, rate of the logarithmic axial strain, compression positive, 1/s
    solver : Solver, optional

    Returns
    -------
    model : Model, model to pass to :func:`multiscale.macro.granulate.simulate_grains`
    step : float, length of a step that resolves the rearrangements, s

    Raises
    ------
    CaseError
        If the pressure is not positive or the rate is negative.
    ConvergenceError
        If the grains have not come to rest under the pressure.

    Notes
    -----
    The grains follow the mean strain and deviate from it as their contacts require, at velocities
    that are halved in every step: the response is quasi-static where the inertial number
    :math:`I = \dot\varepsilon \sqrt{m / (p R)}` is at most 1e-3 (for discs, R is the thickness).
    """
    if not (strain_rate >= 0.0 and np.isfinite(strain_rate)):
        raise CaseError(f"strain_rate must not be negative (1/s), got {strain_rate:g}")
    rigid = replace(law, compliance=0.0)  # compliant contacts creep and never come to rest
    packing = compact(
        radii, pressure, rigid, planar=planar, density=density, solver=solver, seed=seed
    )
    if packing.attrs["failure"]:
        raise ConvergenceError(f"the compaction before the test failed: {packing.attrs['failure']}")
    grains = Grains(
        packing["position"].values[-1],
        packing["radius"].values,
        density,
        thickness=1.0 if planar else None,
    )
    x, y, z = packing["period"].values[-1].tolist()
    step = resolving_step(grains, pressure)
    model = Model(
        grains,
        (),
        law,
        (0.0, 0.0, 0.0),
        (x, y, z),
        damping_rate=float(np.log(2.0)) / step,
        pressure=pressure,
        strain_rate=(None, None, -strain_rate),
    )
    return model, step


def biaxial_curve(result: Dataset) -> Dataset:
    r"""Return stress ratio and volumetric strain against axial strain.

    Parameters
    ----------
    result : Dataset, simulation of a :func:`biaxial_cell`; follows ``GRANULATE``

    Returns
    -------
    Dataset
        Along ``step``: ``axial_strain`` and ``volumetric_strain``, logarithmic, compression
        positive, ``stress_ratio`` q/p and ``mobilised_friction`` :math:`\sin \phi`, dimensionless.

    Notes
    -----
    With the axial stress :math:`\sigma_1` and the mean lateral stress :math:`\sigma_3`, compression
    positive,

    .. math::
        q / p = \frac{\sigma_1 - \sigma_3}{(\sigma_1 + 2 \sigma_3) / 3} \text{ for spheres},
        \quad \frac{\sigma_1 - \sigma_3}{\sigma_1 + \sigma_3} \text{ for discs}, \qquad
        \sin \phi = \frac{\sigma_1 - \sigma_3}{\sigma_1 + \sigma_3}.    \tag{1}
    """
    import xarray as xr

    planar = "thickness" in result.attrs
    stress, strain = -result["stress"].values, -result["strain"].values
    axial, lateral = stress[:, 2], stress[:, 0] if planar else stress[:, :2].mean(axis=1)
    mean = 0.5 * (axial + lateral) if planar else (axial + 2.0 * lateral) / 3.0
    difference = 0.5 * (axial - lateral) if planar else axial - lateral
    with np.errstate(invalid="ignore", divide="ignore"):  # a cell that bears nothing has no ratio
        values = {
            "axial_strain": (strain[:, 2], "axial strain"),
            "volumetric_strain": (strain.sum(axis=1), "volumetric strain"),
            "stress_ratio": (difference / mean, "stress ratio q/p"),
            "mobilised_friction": ((axial - lateral) / (axial + lateral), "sine of the angle"),
        }
    return xr.Dataset(
        {
            name: ("step", value, {"units": "1", "long_name": meaning})
            for name, (value, meaning) in values.items()
        },
        coords={"step": result["step"]},
    )
