"""Statistics of measured surfaces: fits of known spectra."""

import numpy as np
import pytest

from multiscale.micro import self_affine
from multiscale.surfaces import describe_surface


@pytest.mark.parametrize("hurst_exponent", [0.3, 0.7])
def test_the_hurst_exponent_of_a_band_without_longer_or_shorter_waves_is_fitted(hurst_exponent):
    fits = [
        describe_surface(
            self_affine(
                (256, 256),
                (1e-4, 1e-4),
                seed,
                hurst_exponent=hurst_exponent,
                long_cutoff=3e-5,
                short_cutoff=4e-6,
                rms_slope=0.1,
            )
        )
        for seed in range(4)
    ]
    seen = [float(fit["hurst_exponent"]) for fit in fits]
    assert np.mean(seen) == pytest.approx(hurst_exponent, abs=0.06)
    assert max(float(fit["fit_deviation"]) for fit in fits) < 0.5  # decades
