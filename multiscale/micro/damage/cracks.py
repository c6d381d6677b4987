r"""Microcracks that grow where K_I reaches K_Ic; strength and softening law of their volumes.

Cracks of radius a and normal n in a cube of the edge L cover :math:`d = \pi a^2 / L^2` of a
section. Under the mean stress :math:`\sigma` they open and slip if :math:`n \cdot \sigma n > 0`,
and are closed and rough otherwise. Their compliance, Kachanov's sum for small :math:`d`, and the
release of energy by their growth in mode I give

.. math::
    S = S_0 + \sum_i \frac{16 (1-\nu^2)}{3 E L^3}\, \frac{a_i^3}{1 - d_i}\,
    N_i^T \Big[ n n^T + \frac{2}{2-\nu} (1 - n n^T) \Big] N_i, \qquad t = N \sigma,    \tag{1}

.. math:: K_I = 2 (n \cdot t)\, \sqrt{a/\pi}\, \frac{\sqrt{1 - d/3}}{1 - d}.    \tag{2}
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from multiscale.errors import CaseError, require
from multiscale.laws.softening import Softening
from multiscale.micro.damage.cavities import NEGLIGIBLE, Cavities, penny_cracks
from multiscale.micro.damage.sections import plane_damage
from multiscale.schema import CRACK_GROWTH, VOLUME_GROWTH, Dataset, with_cautions

GROWTH = 0.02  # growth of a crack in an event, relative to its radius
CUT = 0.999  # share of a section at which a crack has cut the volume
RECORDS = 25  # number of recorded events of a volume, evenly spread over all events
PLANES = 8  # number of planes of a volume, across the tension, in the search for the worst plane

LEVELS = np.linspace(1.0, 0.0, 41)
"""Stresses over the strength at which openings are averaged over volumes."""

TAIL = 0.025  # probability beyond each end of an interval

UNKNOWN_LAW = (
    "the softening law of the volume is unknown, as its crack reaches another crack before it cuts "
    "the volume; give fewer cracks, or through = true to ignore the other crack"
)


@dataclass(frozen=True, eq=False)
class Microcracks:
    r"""Penny-shaped cracks in a cube of a brittle solid.

    Parameters
    ----------
    edge : float, edge of the cube, m
    centre, normal : ndarray, shape (n, 3), m and unit vectors
    radius : ndarray, shape (n,), m
    youngs_modulus, poissons_ratio : float, moduli of the solid, Pa and dimensionless
    toughness : float, :math:`K_{Ic}` where a crack begins to grow, Pa m\ :sup:`1/2`
    rise, bridging : float
        The toughness rises by the share ``rise`` while a crack grows by a few times the length
        ``bridging``, m: :math:`K_{Ic} [1 + r (1 - e^{-(a - a_0)/l})]`, as grains bridge its faces.
    """

    edge: float
    centre: np.ndarray
    normal: np.ndarray
    radius: np.ndarray
    youngs_modulus: float
    poissons_ratio: float
    toughness: float
    rise: float = 0.0
    bridging: float = 1e-3

    def __post_init__(self) -> None:
        for name in ("edge", "youngs_modulus", "toughness", "bridging"):
            require(name, getattr(self, name), "(0, inf]")
        if not (-1.0 < self.poissons_ratio < 0.5 and self.rise >= 0.0):
            raise CaseError(
                f"poissons_ratio must lie between -1 and 0.5 and rise must not be negative, got "
                f"{self.poissons_ratio:g} and {self.rise:g}"
            )
        widest = float(np.max(self.radius, initial=0.0))
        if not np.size(self.radius) or np.pi * widest**2 >= CUT * self.edge**2:
            raise CaseError(
                f"cracks must be given and must not cut a section of {self.edge:g} m by "
                f"{self.edge:g} m; the largest crack has a radius of {widest:g} m"
            )

    @classmethod
    def of(cls, rve: Cavities, **solid: float) -> Self:
        """Select the cracks of a volume.

        Parameters
        ----------
        rve : Cavities, a periodic cube with circular cracks only, of a :class:`~.Recipe`
        **solid : float, the other parameters of the class
        """
        flat = [kind for kind in rve.bodies if kind.flat]
        semi_axes = [np.linalg.norm(kind.root, axis=1) for kind in flat]
        if np.ptp(rve.size) > NEGLIGIBLE * max(rve.size) or not rve.periodic:
            raise CaseError(
                f"cracks grow in a periodic cube, got a volume of {rve.size} m; give equal sizes"
            )
        if len(flat) < len(rve.bodies) or any(
            np.any(np.ptp(axes, axis=1) > NEGLIGIBLE * axes.max()) for axes in semi_axes
        ):
            raise CaseError(
                "the volume contains pores or elliptic cracks, but the growth law is for circular "
                "cracks only; leave out the others"
            )
        if not flat:
            raise CaseError("the volume contains no crack; give cracks")
        centre, normal = (
            np.concatenate([getattr(kind, name) for kind in flat]) for name in ("centre", "normal")
        )
        return cls(rve.size[0], centre, normal, np.concatenate(semi_axes)[:, 0], **solid)

    def at(self, radius: np.ndarray) -> Cavities:
        """Return the volume with cracks of given radii, shape (n,), m."""
        cracks = penny_cracks(self.centre, self.normal, radius)
        return Cavities((self.edge,) * 3, [cracks], periodic=True)

    @cached_property
    def _unit(self) -> tuple[np.ndarray, np.ndarray]:
        """Normal traction over the stress, (n, 6), and N^T [...] N of (1), (n, 6, 6)."""
        x, y, z = self.normal.T
        o = np.zeros_like(x)
        rows = ((x, o, o, o, z, y), (o, y, o, z, o, x), (o, o, z, y, x, o))
        N = np.array(rows).transpose(2, 0, 1)
        pull = np.einsum("ki,kia->ka", self.normal, N)
        both, slip = N.transpose(0, 2, 1) @ N, 2.0 / (2.0 - self.poissons_ratio)
        return pull, slip * both + (1.0 - slip) * pull[:, :, None] * pull[:, None, :]

    def solid_compliance(self) -> np.ndarray:
        """Compliance of the solid, shape (6, 6), 1/Pa, for shear angles."""
        S, nu = np.zeros((6, 6)), self.poissons_ratio
        S[:3, :3] = (1.0 + nu) * np.eye(3) - nu
        S[3:, 3:] = 2.0 * (1.0 + nu) * np.eye(3)
        return np.asarray(S / self.youngs_modulus)

    def compliance(self, radius: np.ndarray, stress: np.ndarray) -> np.ndarray:
        """Compliance (1), (6, 6), 1/Pa, of cracks with given radii where a stress opens them."""
        d, nu = np.pi * radius**2 / self.edge**2, self.poissons_ratio
        unit = 16.0 * (1.0 - nu**2) / (3.0 * self.youngs_modulus * self.edge**3)
        size = unit * radius**3 / (1.0 - d) * (self.opening_traction(stress) > 0.0)
        return self.solid_compliance() + np.tensordot(size, self._unit[1], axes=1)

    def opening_traction(self, stress: np.ndarray) -> np.ndarray:
        """Return the normal traction on each crack, shape (n,), in the unit of the stress."""
        return np.asarray(self._unit[0] @ stress)

    def intensity(self, radius: np.ndarray, stress: np.ndarray) -> np.ndarray:
        """Stress intensity (2) of open cracks, shape (n,); zero of closed cracks."""
        d = np.pi * radius**2 / self.edge**2
        pull = np.maximum(self.opening_traction(stress), 0.0)
        return np.asarray(2.0 * pull * np.sqrt(radius / np.pi) * np.sqrt(1.0 - d / 3.0) / (1.0 - d))


def grow_microcracks(cracks: Microcracks, stress: np.ndarray, *, through: bool = False) -> Dataset:
    """Grow cracks under a proportional stress until a crack has cut the volume.

    The dissipation is the energy of mode I, which is all for a crack normal to the tension.

    Parameters
    ----------
    stress : ndarray, shape (6,), stress at the factor 1, Pa: xx, yy, zz, yz, xz, xy
    through : bool
        Whether a crack that reaches another crack grows on regardless. Otherwise the search ends
        there, as (1) and (2) do not describe cracks that join.

    Returns
    -------
    Dataset
        Follows ``CRACK_GROWTH``. Factor and strain may both fall from one event to the next.
        ``converged`` is 0 if no crack has cut the volume.
    """
    T = np.asarray(stress, dtype=float)
    first, radius, size = cracks.radius, np.array(cracks.radius, dtype=float), np.linalg.norm(T)
    if not np.any(cracks.opening_traction(T) > 0.0):
        raise CaseError("the stress opens no crack, and closed cracks do not grow in mode I")
    S0 = cracks.compliance(first, T)
    solid, release = cracks.solid_compliance(), 1.0 - cracks.poissons_ratio**2
    largest, spent, touched = np.sqrt(CUT / np.pi) * cracks.edge, 0.0, False
    rows, radii = [], []
    while True:
        # scale the stress so that the most critical crack reaches its toughness
        resistance = cracks.toughness * (
            1.0 + cracks.rise * (1.0 - np.exp(-(radius - first) / cracks.bridging))
        )
        ratio = cracks.intensity(radius, T) / resistance
        worst = int(np.argmax(ratio))
        factor = 1.0 / float(ratio[worst])
        # record the event
        S = cracks.compliance(radius, T)
        opening = cracks.edge * factor * float(T @ (S - S0) @ T) / size
        section = np.pi * float(radius.max()) ** 2 / cracks.edge**2
        touched = touched or _touches(cracks, radius, worst)
        grown = int(np.count_nonzero(radius > first))
        ratio_of_moduli = float(T @ solid @ T) / float(T @ S @ T)
        row = (factor, opening, ratio_of_moduli, section, spent, grown, touched)
        rows.append((*row, *(factor * S @ T)))
        radii.append(radius.copy())
        if radius[worst] >= largest or (touched and not through):
            break
        # grow this crack
        after = min(largest, (1.0 + GROWTH) * radius[worst])
        area = np.pi * (after**2 - radius[worst] ** 2)
        spent += release / cracks.youngs_modulus * float(resistance[worst]) ** 2 * area
        radius[worst] = after
    cut = radius.max() >= largest
    table = np.array(rows, dtype=float)
    names = ("factor", "opening", "modulus_ratio", "largest_section", "dissipation", "grown")
    values = dict(zip((*names, "touching"), table.T, strict=False))
    growth = CRACK_GROWTH.build(
        {**values, "mean_strain": table[:, 7:], "radius": np.array(radii), "converged": int(cut)}
    )
    if not touched:
        return growth
    at = int(np.argmax(table[:, 6]))
    return with_cautions(
        growth,
        f"the growing crack reaches another crack where it covers {100.0 * table[at, 3]:.3g} % of "
        f"a section, at {table[at, 0] / table[:, 0].max():.3g} of the largest stress: "
        + ("from there on the other crack is ignored" if through else "the search ends here"),
    )


def _touches(cracks: Microcracks, radius: np.ndarray, growing: int) -> bool:
    """Whether the ball around the growing crack meets the ball around another crack."""
    away = cracks.centre - cracks.centre[growing]
    away -= cracks.edge * np.round(away / cracks.edge)
    meets = np.linalg.norm(away, axis=1) < radius + radius[growing]
    meets[growing] = False
    return bool(meets.any())


def grow_volumes(
    volumes: Sequence[Microcracks],
    share: np.ndarray,
    *,
    axis: int = 2,
    through: bool = False,
) -> Dataset:
    """Pull volumes, of edges ``share``, until a crack has cut each: ``VOLUME_GROWTH``."""
    pull, n = np.eye(6)[axis], len(volumes)
    curves = np.full((4, n, RECORDS), np.nan)
    laws = np.full((2, n, LEVELS.size), np.nan)
    peak_damage, touching = np.full(n, np.nan), 0
    # growth, and softening law at the levels, of each volume
    for k, cracks in enumerate(volumes):
        grown = grow_microcracks(cracks, pull, through=through)
        stress = grown["factor"].to_numpy()
        at = np.linspace(0, stress.size - 1, RECORDS).round().astype(int)
        radius = grown["radius"].to_numpy()
        curves[:, k] = (
            stress[at],
            grown["mean_strain"].to_numpy()[at, axis],
            [_section(cracks, event, axis) for event in radius[at]],
            grown["modulus_ratio"].to_numpy()[at],
        )
        touching += "cautions" in grown.attrs
        if int(grown["converged"]):
            law = softening_of(grown)
            levels = LEVELS * law.strength
            laws[:, k] = levels, np.interp(-levels, -law.stress, law.opening)
            peak_damage[k] = _section(cracks, radius[np.argmax(stress)], axis)
    # the law has the mean strength and openings at equal shares of it, scaled to the mean energy
    # mean law of the representative volumes
    energy = np.trapezoid(laws[0], laws[1], axis=1)
    whole = (share == 1.0) & np.isfinite(energy)
    if not whole.any():
        raise CaseError(UNKNOWN_LAW)
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
    for name, sample in (("strength", strength[whole]), ("fracture_energy", energy[whole])):
        values[name] = sample.mean()
        for kind, half in zip(("mean_law", "one_part"), half_widths(sample), strict=True):
            values[f"{name}_{kind}"] = sample.mean() * np.exp([-half, half])
    dataset = VOLUME_GROWTH.build(values, edge=max(cracks.edge for cracks in volumes), axis=axis)
    if not touching:
        return dataset
    consequence = (
        "the other crack is ignored"
        if through
        else "its law is unknown; with through = true the other crack is ignored"
    )
    return with_cautions(
        dataset,
        f"in {touching} of {n} volumes the growing crack reaches another crack before it has cut "
        f"the volume: {consequence}",
    )


def softening_of(growth: Dataset, strength: float = 1.0) -> Softening:
    """Return the softening law of a volume from the growth of its cracks.

    Parameters
    ----------
    growth : Dataset, follows ``CRACK_GROWTH``, under tension along an axis
    strength : float, stress at the factor 1, Pa

    Notes
    -----
    The law begins at the largest stress; the opening up to it is spread over the volume and does
    not belong to the crack.
    """
    if not int(growth["converged"]):
        raise CaseError(UNKNOWN_LAW)
    factor, opening = growth["factor"].to_numpy(), growth["opening"].to_numpy()
    peak = int(np.argmax(factor))
    w, s = opening[peak:] - opening[peak], strength * factor[peak:]
    falling = [0]  # events after which the stress is lower and the opening larger
    for k in range(1, w.size):
        if w[k] > w[falling[-1]] and s[k] < s[falling[-1]]:
            falling.append(k)
    w, s = w[falling], s[falling]
    last = w[-1] + (w[-1] - w[-2]) * s[-1] / max(s[-2] - s[-1], 1e-300)
    return Softening(np.append(w, last), np.append(s, 0.0))


def softening_samples(growth: Dataset) -> list[Softening]:
    """Return the mean softening law of ``VOLUME_GROWTH``, then the laws of all whole volumes."""
    whole = (growth["share"].to_numpy() == 1.0) & (growth["converged"].to_numpy() == 1)
    w, s = (growth[f"softening_{name}"].to_numpy()[whole] for name in ("opening", "stress"))
    mean = Softening(growth["mean_opening"].to_numpy(), growth["mean_stress"].to_numpy())
    return [mean, *map(Softening, w, s)]


def half_widths(values: np.ndarray) -> tuple[float, float]:
    """Half-widths of 95 % intervals of the logarithm: of the mean, and of a further value."""
    from scipy.special import stdtrit

    n = values.size
    if n < 2:
        return np.nan, np.nan
    half = float(stdtrit(n - 1, 1.0 - TAIL) * np.log(values).std(ddof=1))
    return half / np.sqrt(n), half * np.sqrt(1.0 + 1.0 / n)


def _section(cracks: Microcracks, radius: np.ndarray, axis: int) -> float:
    """Largest damage on planes normal to an axis through the cracks of largest projection."""
    widest = np.argsort(radius**2 * np.abs(cracks.normal[:, axis]))[-PLANES:]
    offset = cracks.centre[widest, axis] % cracks.edge - 0.5 * cracks.edge
    return float(plane_damage(cracks.at(radius), np.eye(3)[axis], offset).max())
