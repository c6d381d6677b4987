"""What several tests need."""

import signal
from contextlib import contextmanager

import numba
import numpy as np

from multiscale.io import save_law
from multiscale.micro import Surface
from multiscale.nonsmooth.projections import project_ball
from multiscale.schema import MICRO_RESPONSE, branch_of
from multiscale.upscaling import fit_law


@contextmanager
def threads(count):
    """Give the kernels a number of threads, at most those of the machine."""
    before = numba.get_num_threads()
    numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))
    try:
        yield
    finally:
        numba.set_num_threads(before)


def observed_rate(sizes, errors):
    """Slope of log error against log size, by least squares."""
    return float(np.polyfit(np.log(sizes), np.log(np.abs(errors)), 1)[0])


def alart_curnier(velocity, reaction, friction, step=1.0):
    """Residual of Coulomb's law after Alart and Curnier: normal and tangent apart."""
    ahead = reaction - step * velocity
    normal = np.maximum(ahead[0], 0.0)
    tangent = project_ball(ahead[1:], friction * normal)
    return reaction - np.concatenate([normal[None], tangent])


def wave(points, amplitude):
    """A cosine along x with wavelength 1 m, uniform along y."""
    nx, ny = points
    x = 2.0 * np.pi * np.arange(nx) / nx
    return Surface(np.tile(amplitude * np.cos(x)[:, None], (1, ny)), (1.0, ny / nx))


def egg_box(n, amplitude):
    """Product of two cosines with wavelength 1 m."""
    x = np.cos(2.0 * np.pi * np.arange(n) / n)
    return Surface(amplitude * np.outer(x, x), (1.0, 1.0))


def write_law(path, pressure=(1e6, 200e6)):
    """Write the law fitted to exponential data between two pressures, and return its path."""
    p = np.geomspace(*pressure, 9)
    ones = np.ones((1, p.size), dtype=int)
    response = {
        "displacement_jump": np.zeros((1, p.size, 3)),
        "traction": -p[None, :, None] * np.array([1.0, 0.0, 0.0]),
        "mean_gap": 0.2e-6 * np.log(2e9 / p)[None],
        "contact_fraction": p[None] / 5e9,
        "converged": ones,
        "active_set_iterations": ones,
        "linear_iterations": ones,
        "wall_time": 1.0 * ones,
        "branch": branch_of(p),
    }
    save_law(fit_law(MICRO_RESPONSE.build(response)), path)
    return path


def keep_ignoring_broken_pipes():
    """Undo what gmsh.initialize does: afterwards a pool whose worker dies would end all tests."""
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)
