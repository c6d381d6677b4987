"""What several tests need."""

import signal

import numpy as np

from multiscale.micro import Surface


def observed_rate(sizes, errors):
    """Slope of log error against log size, by least squares."""
    return float(np.polyfit(np.log(sizes), np.log(np.abs(errors)), 1)[0])


def wave(points, amplitude):
    """A cosine along x with wavelength 1 m, uniform along y."""
    nx, ny = points
    x = 2.0 * np.pi * np.arange(nx) / nx
    return Surface(np.tile(amplitude * np.cos(x)[:, None], (1, ny)), (1.0, ny / nx))


def egg_box(n, amplitude):
    """Product of two cosines with wavelength 1 m."""
    x = np.cos(2.0 * np.pi * np.arange(n) / n)
    return Surface(amplitude * np.outer(x, x), (1.0, 1.0))


def keep_ignoring_broken_pipes():
    """Undo what gmsh.initialize does: afterwards a pool whose worker dies would end all tests."""
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)
