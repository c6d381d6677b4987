"""Friction coefficients out of responses that slide."""

from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError
from multiscale.schema import MICRO_RESPONSE
from multiscale.upscaling.observations import Observations, observe, usable_steps

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["friction_observations"]


def friction_observations(response: "xr.Dataset") -> Observations:
    r"""Friction coefficients of a response that slides steadily, such as a sheared layer of grains.

    Parameters
    ----------
    response : Dataset
        Follows ``MICRO_RESPONSE``, with ``sliding_speed`` along ``step``.

    Returns
    -------
    Observations
        Of ``"friction_coefficient"``: :math:`|t_T| / p` for each realisation and step that
        converged, at its pressure and speed.

    Raises
    ------
    CaseError
        If no speed is given or no step converged.
    """
    MICRO_RESPONSE.check(response)
    if "sliding_speed" not in response.variables:
        raise CaseError(
            "the response has no sliding_speed: friction is observed where a cell slides steadily"
        )
    counted, pressure = usable_steps(response)
    traction = response["traction"].to_numpy()
    coefficient = np.linalg.norm(traction[..., 1:], axis=-1) / np.abs(traction[..., 0])
    speed = np.asarray(response["sliding_speed"].to_numpy(), dtype=float)
    bodies = response.attrs.get("bodies", "")
    return observe(
        "friction_coefficient",
        (pressure, speed),
        np.where(counted, coefficient, np.nan),
        bodies=str(bodies),
    )
