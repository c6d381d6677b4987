"""Law of an interface from the statistics of its asperities."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from multiscale.errors import ConvergenceError
from multiscale.laws.asperities import Asperities, asperity_loads
from multiscale.laws.interface_law import InterfaceLaw, Response, Sliding
from multiscale.laws.parameters import check_parameter

__all__ = ["AsperityLaw"]

STICKING_SLIP = 1e-3
"""Slip in a step up to which an asperity counts as sticking, as of the slabs of sliders."""

MAX_ITERATIONS, TOLERANCE = 200, 1e-13
"""Iteration limit of resolvents, and their residual relative to the largest of three terms."""

AT_LIMIT = 1.0 - 1e-9
"""Share of the friction limit from which a class slips."""


@dataclass(frozen=True, eq=False)
class AsperityLaw(InterfaceLaw):
    r"""Law of Greenwood and Williamson with yield, memory and a slider for every class of height.

    Parameters
    ----------
    asperities : Asperities, statistics and material
    friction : float, friction coefficient :math:`\mu \ge 0`, dimensionless
    stiffness_ratio : float, optional
        Tangential over normal stiffness :math:`\kappa`; :math:`2(1-\nu)/(2-\nu)` if not given.
    gap : float, initial gap between the planes from which heights count, m
    yields : bool, false once it is shaken down, see :meth:`shaken_down`

    Raises
    ------
    CaseError
        If a parameter is outside its range.

    Notes
    -----
    Classes i of height :math:`z_i` and :math:`n_i` asperities per area [1]_ carry

    .. math:: p = \sum_i N_i, \qquad N_i = n_i F(z_i - g),    \tag{1}

    with the force F of :class:`Asperities`, whose memory is the smallest gap so far. Each class has
    one tangential spring, as stiff as :math:`\kappa` times the normal stiffness of the class on its
    unloading curve, :math:`w_i = n_i\, 2 E^* \sqrt{R_i e_i}`, and a slider with the limit
    :math:`\mu N_i` [2]_. Its step is (b) to (d) of :class:`Sliders`, with the mean stiffness of
    the step for m, so that no path gains energy; the force is a vector, where [2]_ has one slider
    for each direction.

    The state is the largest approach of the highest asperities, m, zero before the first loading,
    then force and stiffness of every spring and the last jump, as of :class:`Sliders`.

    References
    ----------
    .. [1] J. A. Greenwood and J. B. P. Williamson, Proc. R. Soc. A 295 (1966) 300-319,
       doi:10.1098/rspa.1966.0242.
    .. [2] J. H. Porter and M. R. W. Brake, Mech. Syst. Signal Process. 192 (2023) 110210: rough
       contact of the Brake-Reuss beam.

    Examples
    --------
    >>> one = Asperities(np.array([0.0]), np.array([1e6]), 1e-3, 200e9, 0.3)  # alike, elastic
    >>> law = AsperityLaw(one, friction=0.1)
    >>> jump = np.array([[-1e-6], [1e-9], [0.0]])  # m
    >>> law.respond(jump, law.at_rest(jump * [[1.0], [0.0], [0.0]])).traction.ravel().round(-1)
    array([-4633370.,     5720.,        0.])
    """

    asperities: Asperities
    friction: float = 0.0
    stiffness_ratio: float | None = None
    gap: float = 0.0
    yields: bool = True

    def __post_init__(self) -> None:
        check_parameter(self, "friction", lowest=0.0)
        if self.stiffness_ratio is not None:
            check_parameter(self, "stiffness_ratio")

    @property
    def n_state(self) -> int:  # type: ignore[override]
        """Number of rows of the state."""
        return 4 + 3 * self.asperities.height.size

    @cached_property
    def normal_law(self) -> "AsperityLaw":
        """Law of the gap alone."""
        return replace(self, friction=0.0)

    def shaken_down(self) -> "AsperityLaw":
        """Return the law of the same state whose asperities yield no more.

        They stay on their curves of unloading, beyond the largest approach, too: small motions
        about a preload, after a few cycles.
        """
        return replace(self, yields=False)

    def unsheared(self, state: np.ndarray) -> np.ndarray:
        """Return the state with the same pressure and no force in the sliders."""
        return np.concatenate([state[:1], np.zeros_like(state[1:-3]), state[-3:]])

    def at_rest(self, jump: np.ndarray) -> np.ndarray:
        """Return the state of an interface pressed to a jump, m, without shear."""
        state = np.zeros((self.n_state, *jump.shape[1:]))
        state[0] = self._peak(jump[0], state[0])
        state[-3:] = jump
        return state

    def from_here(self, state: np.ndarray) -> np.ndarray:
        """Return the state whose last tangential jump is zero."""
        return np.concatenate([state[:-2], np.zeros((2, *state.shape[1:]))])

    def friction_limit(self, pressure: np.ndarray) -> np.ndarray:
        """Return Coulomb's limit, Pa, at a pressure, Pa."""
        return self.friction * pressure

    def respond(self, jump: np.ndarray, state: np.ndarray) -> Response:
        """Evaluate (1) and the sliders, with their consistent tangent."""
        return self._step(jump, state)[0]

    def sliding(self, jump: np.ndarray, state: np.ndarray) -> Sliding:
        """Return slip and energy of a step; see :class:`InterfaceLaw`."""
        if not self.friction:
            return super().sliding(jump, state)
        response, (work, before, after, slipping) = self._step(jump, state)
        return Sliding(slipping, work - (after - before), after, response.state)

    def slipping_load(self, jump: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Share of the pressure of classes at their friction limit; see :class:`InterfaceLaw`."""
        if not self.friction:
            return super().slipping_load(jump, state)
        new = self.respond(jump, state).state
        N = self._loads(jump[0], new[0])[0].reshape(-1, *jump.shape[1:])
        force = self._kappa * np.hypot(*np.split(new[1:-3], 3)[:2])
        slips = np.sum(np.where(force >= AT_LIMIT * self.friction * N, N, 0.0), axis=0)
        p = N.sum(axis=0)
        return np.asarray(np.where(p > 0.0, slips / np.where(p > 0.0, p, 1.0), 1.0))

    def resolvent(
        self, source: np.ndarray, stiffness: float | np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Find the jump on the law and on a search direction; see :class:`InterfaceLaw`.

        The normal row increases with the jump: Newton's method between bounds of the root.
        """
        from multiscale.laws.slabs import resolve

        k = np.full(source.shape, stiffness, dtype=float)
        jump: np.ndarray = source / k
        jump[0] = self._resolve_normal(source[0], k[0], state[0])
        if not self.friction:
            return jump
        end = self._loads(jump[0], state[0])
        found, failed = resolve(
            _flat(source),
            _flat(k),
            _flat(state[1:]),
            self._loads(state[-3], state[0]),
            end,
            np.zeros((3, 0)),
            self.friction,
            self._kappa,
        )
        if np.any(failed):
            raise ConvergenceError(
                f"the resolvent of AsperityLaw found no tangential jump at {np.sum(failed)} of "
                f"{failed.size} points; check that the source is finite (Pa)"
            )
        jump[1:] = found.reshape(2, *jump.shape[1:])
        return jump

    @property
    def _kappa(self) -> float:
        """Tangential over normal stiffness."""
        return self.stiffness_ratio or self.asperities.stiffness_ratio

    def _peak(self, jump: np.ndarray, peak: np.ndarray) -> np.ndarray:
        """Largest approach of the highest asperities so far, m."""
        approach = self.asperities.top - (jump + self.gap)
        return np.maximum(peak, np.maximum(approach, 0.0)) if self.yields else peak

    def _loads(self, jump: np.ndarray, peak: np.ndarray) -> np.ndarray:
        """Load, stiffness and derivatives of the classes, shape (4, classes, points)."""
        one = self.asperities
        gap = np.ascontiguousarray(jump + self.gap, dtype=float).reshape(-1)
        most = np.ascontiguousarray(peak, dtype=float).reshape(-1)
        return np.asarray(
            asperity_loads(gap, most, self.yields, one.height, one.density, *one.table, _hertz(one))
        )

    def _step(self, jump: np.ndarray, state: np.ndarray) -> tuple[Response, np.ndarray]:
        """Return response, and work, stored energy before and after, and slipping share."""
        from multiscale.laws.slabs import respond_slabs

        shape, d = jump.shape[1:], len(jump)
        end = self._loads(jump[0], state[0])
        traction, tangent = np.zeros(jump.shape), np.zeros((d, d, *shape))
        traction[0] = -end[0].sum(axis=0).reshape(shape)  # (1)
        tangent[0, 0] = -end[2].sum(axis=0).reshape(shape)
        peak = self._peak(jump[0], state[0])[None]
        if not self.friction:
            bed = np.zeros((len(state) - 4, *shape))
            return Response(traction, tangent, np.concatenate([peak, bed, jump])), np.zeros(
                (4, *shape)
            )
        shear, slopes, bed, account = respond_slabs(
            _flat(jump),
            _flat(state[1:]),
            self._loads(state[-3], state[0]),
            end,
            np.zeros((3, 0)),
            np.zeros((3, 0)),
            self.friction,
            self._kappa,
            STICKING_SLIP,
        )
        traction[1:] = shear.reshape(2, *shape)
        tangent[1:] = slopes.reshape(2, 3, *shape)
        new = np.concatenate([peak, bed.reshape(len(bed), *shape)])
        return Response(traction, tangent, new), account.reshape(4, *shape)

    def _resolve_normal(self, source: np.ndarray, k: np.ndarray, peak: np.ndarray) -> np.ndarray:
        """Find the normal jump between b/k, where p >= 0 is left of it, and first contact."""
        low: np.ndarray = source / k
        high = np.maximum(low, self.asperities.top - self.gap)
        jump = np.asarray(high)
        for _ in range(MAX_ITERATIONS):
            loads = self._loads(jump, peak).sum(axis=1).reshape(4, *jump.shape)
            t = -loads[0]
            f = t + k * jump - source
            scale = np.maximum(np.maximum(np.abs(t), np.abs(source)), k * np.abs(jump))
            low, high = np.where(f <= 0.0, jump, low), np.where(f >= 0.0, jump, high)
            tight = high - low <= 4.0 * np.finfo(float).eps * (np.abs(low) + np.abs(high))
            if np.all((np.abs(f) <= TOLERANCE * scale) | tight):
                return jump
            step = jump - f / (k - loads[2])
            jump = np.where((step > low) & (step < high), step, 0.5 * (low + high))
        raise ConvergenceError(
            f"the resolvent of AsperityLaw found no normal jump (relative residual "
            f"{float(np.max(np.abs(f) / scale)):.1e}); check that the source is finite (Pa)"
        )


def _hertz(one: Asperities) -> float:
    """Force of an elastic asperity over its approach to the power 3/2, N m^-3/2."""
    return float(4.0 / 3.0 * one.contact_modulus * np.sqrt(one.radius))


def _flat(value: np.ndarray) -> np.ndarray:
    """Return an array with all points in one axis."""
    return np.ascontiguousarray(value, dtype=float).reshape(len(value), -1)
