"""Laws of an earlier version that lack entries of this version are refused in a sentence."""

import numpy as np
import pytest

from multiscale.errors import MultiscaleError
from multiscale.upscaling import (
    area_from_dataset,
    error_budget,
    fit_branches,
    fit_law,
    hysteretic_from_dataset,
    law_band,
    law_from_dataset,
    law_sources,
    with_budget,
    write_law_table,
    write_pressure_overclosure,
)
from tests.upscaling.responses import PRESSURE, exponential_gaps, response_of

RESPONSE = response_of(exponential_gaps(6, spread=0.1))


def flowed():
    """Loaded and unloaded, with a state that shows it."""
    down = PRESSURE[-2::-1]
    up = exponential_gaps(6, spread=0.1)
    gaps = np.concatenate([up, up[:, -1:] + 0.3 * (up[:, -2::-1] - up[:, -1:])], axis=1)
    pressure = np.concatenate([PRESSURE, down])
    response = response_of(gaps, pressure, area=np.tile(pressure / 1e10, (6, 1)))
    return response.assign(flowing_fraction=response["contact_fraction"])


FREE = fit_law(RESPONSE, n_samples=80)
READERS = {
    "free form": (FREE, lambda law, out: law_from_dataset(law, 1)),
    "exponential": (
        fit_law(RESPONSE, family="exponential", n_samples=80),
        lambda law, out: law_from_dataset(law, 1),
    ),
    "area": (FREE, lambda law, out: area_from_dataset(law, 1)),
    "band": (FREE, lambda law, out: law_band(law, lambda item: item.gap_at(PRESSURE))),
    "unloading": (
        fit_branches(flowed(), n_samples=20),
        lambda law, out: hysteretic_from_dataset(law, 1),
    ),
    "table": (FREE, lambda law, out: write_law_table(law, out / "law.csv")),
    "input file": (
        FREE,
        lambda law, out: write_pressure_overclosure(law, out / "law.inp", length_unit="um"),
    ),
    "budget": (
        with_budget(FREE, error_budget(RESPONSE, FREE)),
        lambda law, out: law_sources(law),
    ),
}

WHOLE = ("family", "error_half_width", "unloading_stiffness_ratio")
"""Entries that define the kind of a law, or whether a part is there at all."""


@pytest.mark.parametrize("reader", READERS)
def test_whatever_a_law_lacks_is_named(reader, tmp_path):
    law, read = READERS[reader]
    read(law, tmp_path)
    sentences = {}
    for name in [*law.data_vars, *law.attrs]:
        old = law.drop_vars(name) if name in law.data_vars else law.copy()
        old.attrs.pop(name, None)
        try:
            read(old, tmp_path)
        except MultiscaleError as error:
            sentences[name] = str(error)
    assert sentences
    for name, sentence in sentences.items():
        assert name in sentence or name in WHOLE
        assert "run the fit again" in sentence or "add" in sentence
