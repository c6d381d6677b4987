"""Frequency and damping of several modes of a structure at rest, as one dataset."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from multiscale.macro.vibration.backbone import Amplitudes, Backbone, follow_backbone
from multiscale.macro.vibration.preloaded import Preloaded
from multiscale.macro.vibration.tangent_modes import TangentModes
from multiscale.schema import COMPONENTS, VIBRATION, Dataset, with_cautions

__all__ = ["vibrate"]


def vibrate(
    rest: Preloaded,
    modes: TangentModes,
    load: np.ndarray,
    amplitudes: Mapping[int, Amplitudes],
    *,
    material_damping: float = 0.0,
    progress: Callable[[int, int], None] = lambda finished, total: None,
) -> Dataset:
    """Follow modes over their amplitudes.

    Parameters
    ----------
    rest : Preloaded
    modes : TangentModes
    load : ndarray, shape (whole unknowns, modes), M phi of all modes, kg^1/2
    amplitudes : mapping of int to Amplitudes, of the modes that are followed, counted from 0
    material_damping : float, share of critical damping that the bodies give every mode
    progress : callable, gets the number of amplitudes that are finished, and of all

    Returns
    -------
    Dataset
        Follows ``VIBRATION``; a step is an amplitude of a mode. Steps from which on a mode slides
        away are NaN with ``converged`` 0, and the attribute ``failure`` says why.
    """
    total, done = 2 * sum(len(one.values) for one in amplitudes.values()), 0

    def count() -> None:
        nonlocal done
        done += 1
        progress(done, total)

    progress(0, total)
    found = {
        mode: follow_backbone(rest, modes, load, mode, asked, count)
        for mode, asked in amplitudes.items()
    }
    shape = modes.nodal(rest.free)
    largest = np.linalg.norm(shape, axis=2).max(axis=1)
    curves, q = list(found.values()), [np.array(one.values) for one in amplitudes.values()]
    joint = np.concatenate([one.damping for one in curves])
    frequency = np.concatenate([one.frequency for one in curves])
    number = np.repeat([*found], [one.size for one in q])
    values: dict[str, Any] = {
        "mode_frequency": modes.frequency,
        "shape": shape,
        "position": rest.free.position,
        "step_mode": 1 + number,
        "modal_amplitude": np.concatenate(q),
        "largest_displacement": np.concatenate(
            [largest[mode] * one for mode, one in zip(found, q, strict=True)]
        ),
        "frequency": frequency,
        "fall": modes.frequency[number] - frequency,
        "damping": material_damping + joint,
        "opens": np.concatenate([one.opens for one in curves]).astype(int),
        "converged": np.isfinite(joint).astype(int),
    }
    if rest.state.jump.size:
        values |= _joints(rest, curves)
    result = VIBRATION.build(values).assign_coords(
        component=["x", "y", "z"], mode=1 + np.arange(len(shape))
    )
    if rest.state.jump.size:
        result = result.assign_coords(direction=list(COMPONENTS))
    told = [
        f"mode {mode + 1}: contact opens at amplitudes from "
        f"{asked.values[int(np.argmax(curve.opens))]:.4g} kg^1/2 m on, where Masing's rule does "
        f"not hold: a full cycle tells the loss, and both directions differ"
        for (mode, asked), curve in zip(amplitudes.items(), curves, strict=True)
        if curve.opens.any()
    ]
    told += [
        f"modes {', '.join(str(mode + 1) for mode in group)} have one frequency, and any sum of "
        f"their shapes is a mode: the shapes are chosen to move along the axes"
        for group in modes.coinciding
    ]
    if any(one.sheared for one in curves):
        told.append(
            "the preload leaves shear in the joints, so that both directions differ and Masing's "
            "rule does not hold: full cycles tell frequency and loss; a preload without "
            "friction leaves none"
        )
    result = with_cautions(result, str(rest.path.attrs.get("cautions", "")), *told)
    failures = [one.failure for one in curves if one.failure]
    return result.assign_attrs(failure="\n".join(failures)) if failures else result


def _joints(rest: Preloaded, curves: list[Backbone]) -> dict[str, Any]:
    """Traction and slip at the points of the joints, at rest and at the amplitudes."""
    path = rest.path
    pressure = np.concatenate([one.pressure for one in curves], axis=1)
    slipping = np.concatenate([one.slipping for one in curves], axis=1)
    load = np.maximum(np.nan_to_num(pressure), 0.0) * path["point_area"].values
    carried = load.sum(axis=2)
    slips = np.sum(load * np.nan_to_num(slipping), axis=2)
    share = (slips / np.where(carried > 0.0, carried, np.nan)).max(axis=0)
    told = ("point_position", "point_area", "point_joint")
    return {name: path[name].values for name in told} | {
        "rest_traction": path["traction"].values[-1],
        "pressure": pressure,
        "slipping": slipping,
        "slipping_load": share,
    }
