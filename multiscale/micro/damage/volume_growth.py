"""Cracks that grow in several volumes: strength, fracture energy, softening law, size effect."""

from collections.abc import Sequence

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.softening import Softening
from multiscale.micro.damage.crack_growth import Microcracks, grow_microcracks
from multiscale.micro.damage.sections import plane_damage
from multiscale.schema import VOLUME_GROWTH, Dataset, with_cautions

__all__ = ["grow_volumes", "half_widths", "softening_of", "softening_samples"]

RECORDS = 25
"""Events of a volume that are kept, evenly spread over all."""

PLANES = 8
"""Planes of a volume among which the worst one is searched, across the pull."""

LEVELS = np.linspace(1.0, 0.0, 41)
"""Stresses over the strength at which openings are averaged over volumes."""

TAIL = 0.025


def grow_volumes(
    volumes: Sequence[Microcracks],
    share: np.ndarray,
    *,
    axis: int = 2,
    through: bool = False,
) -> Dataset:
    r"""Pull volumes along an axis until one crack of each has cut it.

    Parameters
    ----------
    volumes : sequence of Microcracks
    share : ndarray, shape (volumes,)
        Edge over the edge of the representative volume; 1 for representative ones.
    axis : int, of the pull
    through : bool, see :func:`~.crack_growth.grow_microcracks`

    Returns
    -------
    Dataset
        Follows ``VOLUME_GROWTH``. ``damage`` is the largest of eq (1) on planes across the pull
        through the cracks with the largest projections. The mean softening law has the mean
        strength, and the openings :math:`w(s)`, averaged at equal shares s of the strengths, are
        scaled to the mean fracture energy. A volume that no crack has cut has NaN for its law.

    Raises
    ------
    CaseError
        If no representative volume is cut, or the pull opens no crack of a volume.
    """
    pull, n = np.eye(6)[axis], len(volumes)
    curves = np.full((4, n, RECORDS), np.nan)
    laws = np.full((2, n, LEVELS.size), np.nan)
    peak_damage, touching = np.full(n, np.nan), 0
    for k, cracks in enumerate(volumes):
        grown = grow_microcracks(cracks, pull, through=through)
        stress = grown["factor"].to_numpy()
        at = np.linspace(0, stress.size - 1, RECORDS).round().astype(int)
        radius = grown["radius"].to_numpy()
        curves[:, k] = (
            stress[at],
            grown["mean_strain"].to_numpy()[at, axis],
            [_section(cracks, one, axis) for one in radius[at]],
            grown["modulus_ratio"].to_numpy()[at],
        )
        touching += "cautions" in grown.attrs
        if int(grown["converged"]):
            law = softening_of(grown)
            levels = LEVELS * law.strength
            laws[:, k] = levels, np.interp(-levels, -law.stress, law.opening)
            peak_damage[k] = _section(cracks, radius[np.argmax(stress)], axis)
    energy = np.trapezoid(laws[0], laws[1], axis=1)
    whole = (share == 1.0) & np.isfinite(energy)
    if not whole.any():
        raise CaseError(
            "the softening law of the volume is unknown, as its crack reaches another one before "
            "it cuts the volume; give fewer cracks, or through = true, as if it grew alone"
        )
    strength = laws[0, :, 0]
    mean_stress, opening = laws[:, whole].mean(axis=1)
    opening *= energy[whole].mean() / np.trapezoid(mean_stress, opening)
    values = {
        "share": share,
        **dict(zip(("stress", "strain", "damage", "modulus_ratio"), curves, strict=True)),
        "volume_strength": strength,
        "volume_energy": energy,
        "peak_damage": peak_damage,
        "softening_stress": laws[0],
        "softening_opening": laws[1],
        "mean_stress": mean_stress,
        "mean_opening": opening,
        "converged": np.isfinite(energy).astype(int),
    }
    for name, found in (("strength", strength[whole]), ("fracture_energy", energy[whole])):
        values[name] = found.mean()
        for kind, half in zip(("mean_law", "one_part"), half_widths(found), strict=True):
            values[f"{name}_{kind}"] = found.mean() * np.exp([-half, half])
    dataset = VOLUME_GROWTH.build(values, edge=max(one.edge for one in volumes), axis=axis)
    if not touching:
        return dataset
    ends = (
        "it grows on as if it were alone"
        if through
        else "its law is unknown; through = true lets it grow on as if it were alone"
    )
    return with_cautions(
        dataset,
        f"in {touching} of {n} volumes the crack that grows reaches another one before it has cut "
        f"the volume: {ends}",
    )


def softening_of(growth: Dataset, strength: float = 1.0) -> Softening:
    """Return the softening law of a volume from the growth of its cracks.

    Parameters
    ----------
    growth : Dataset
        Follows ``CRACK_GROWTH``, of pull along one direction.
    strength : float, stress at the factor one, Pa

    Notes
    -----
    The law begins at the largest stress; what opens before is spread over the volume and is no
    part of the crack.

    Raises
    ------
    CaseError
        If no crack has cut the volume.
    """
    if not int(growth["converged"]):
        raise CaseError(
            "the softening law of the volume is unknown, as its crack reaches another one before "
            "it cuts the volume; give fewer cracks, or through=True, as if it grew alone"
        )
    factor, opening = growth["factor"].to_numpy(), growth["opening"].to_numpy()
    peak = int(np.argmax(factor))
    w, s = opening[peak:] - opening[peak], strength * factor[peak:]
    kept = [0]
    for k in range(1, w.size):
        if w[k] > w[kept[-1]] and s[k] < s[kept[-1]]:
            kept.append(k)
    w, s = w[kept], s[kept]
    last = w[-1] + (w[-1] - w[-2]) * s[-1] / max(s[-2] - s[-1], 1e-300)
    return Softening(np.append(w, last), np.append(s, 0.0))


def softening_samples(growth: Dataset) -> list[Softening]:
    """Return the mean softening law of ``VOLUME_GROWTH``, then the laws of all whole volumes."""
    whole = (growth["share"].to_numpy() == 1.0) & (growth["converged"].to_numpy() == 1)
    w, s = (growth[f"softening_{name}"].to_numpy()[whole] for name in ("opening", "stress"))
    mean = Softening(growth["mean_opening"].to_numpy(), growth["mean_stress"].to_numpy())
    return [mean, *(Softening(*one) for one in zip(w, s, strict=True))]


def half_widths(values: np.ndarray) -> tuple[float, float]:
    """Half-widths of 95 % intervals of a mean and of one further value; NaN of one value.

    They are those of the logarithm, which is normal: strengths and energies are positive.
    """
    from scipy.special import stdtrit

    n = values.size
    if n < 2:
        return np.nan, np.nan
    half = float(stdtrit(n - 1, 1.0 - TAIL) * np.log(values).std(ddof=1))
    return half / np.sqrt(n), half * np.sqrt(1.0 + 1.0 / n)


def _section(cracks: Microcracks, radius: np.ndarray, axis: int) -> float:
    """Largest damage on planes across an axis through the cracks of the largest projections."""
    widest = np.argsort(radius**2 * np.abs(cracks.normal[:, axis]))[-PLANES:]
    offset = cracks.centre[widest, axis] % cracks.edge - 0.5 * cracks.edge
    return float(plane_damage(cracks.at(radius), np.eye(3)[axis], offset).max())
