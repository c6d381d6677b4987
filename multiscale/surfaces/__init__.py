r"""Rough surfaces: synthesis, preparation of measured maps, and statistics.

These functions use the discrete Fourier series of a periodic surface on its cell
:math:`L_x \times L_y`,

.. math::
    h(x) = \sum_q \hat h_q\, e^{i q \cdot x}, \qquad
    q = 2\pi \left(\frac{i}{L_x}, \frac{j}{L_y}\right),    \tag{1}

so that a mean over the cell is a sum over the modes,
:math:`\langle h^2 \rangle = \sum_q |\hat h_q|^2` (Parseval). For nodes, units
and the size of the cell see :class:`multiscale.surfaces.Surface`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
