"""The bars of an error budget are as high as its totals and name missing terms."""

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr

from multiscale.plotting import plot_error_budget
from multiscale.plotting.budget_figures import plot_costs, step_labels
from multiscale.upscaling import error_budget, fit_law, with_budget
from tests.upscaling.responses import exponential_gaps, response_of


@pytest.fixture
def axes():
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, ax = plt.subplots()
    yield ax
    plt.close(figure)


@pytest.mark.parametrize("carried", [False, True])
def test_bars_stack_up_to_the_total(axes, carried):
    response = response_of(exponential_gaps(8) + 2e-8 * np.cos(np.arange(8)))
    law = fit_law(response, n_samples=80)
    budget = error_budget(response, law)
    dataset = with_budget(law, budget) if carried else budget
    ax = plot_error_budget(dataset, quantity="stiffness", ax=axes)
    top = np.zeros(8)
    *known, unknown = ax.containers
    for container in known:
        for k, bar in enumerate(container):
            top[k] = max(top[k], bar.get_y() + bar.get_height())
    total = budget["error_total"].sel(quantity="stiffness").values
    np.testing.assert_allclose(top, 100.0 * total)
    assert len(known) == 3
    np.testing.assert_allclose([bar.get_y() for bar in unknown], top)  # hatched, above the total
    assert all(bar.get_hatch() and bar.get_height() > 0.0 for bar in unknown)
    assert [text.get_text() for text in ax.texts] == [f"{value:.2g} + ?" for value in top]
    names = [text.get_text() for text in ax.get_legend().get_texts()]
    assert names[:3] == ["sampling", "fit", "model discrepancy"]
    assert names[3].startswith("not known: ")
    assert "scale separation" in names[3]
    assert ax.get_ylabel() == "95 % half-width of stiffness (%)"
    assert ax.get_xticklabels()[0].get_text() == "5"


def test_a_total_that_lacks_a_term_is_as_high_as_the_known_terms(axes):
    """One realisation has no information on the sampling."""
    response = response_of(exponential_gaps(1))
    budget = error_budget(response, fit_law(response))
    ax = plot_error_budget(budget, ax=axes)
    terms = budget["error_half_width"].sel(quantity="mean_gap")
    known = 100.0 * np.hypot(*(terms.sel(error_term=t) for t in ("fit", "model discrepancy")))
    known = known[known > 0.02 * known.max()]  # lower bars have no caption
    assert budget["error_total"].isnull().all()
    assert [text.get_text() for text in ax.texts] == [f"{value:.2g} + ?" for value in known]
    assert ax.get_legend().get_texts()[-1].get_text().startswith("not known: sampling, ")


def test_steps_of_loads_have_numbers_and_no_pressure():
    law = fit_law(response_of(exponential_gaps(8)), n_samples=0)
    pressed = error_budget(response_of(exponential_gaps(8)), law)
    assert step_labels(pressed, unit=" MPa")[0].endswith(" MPa")
    loaded = pressed[["error_half_width"]].reset_coords(drop=True).assign_coords(step=range(8))
    assert step_labels(loaded, unit=" MPa")[:2] == ["step 0", "step 1"]


def test_steps_of_a_vibration_have_their_amplitudes():
    sizes = {"largest_displacement": ("step", [2e-7, 1e-6]), "step_mode": ("step", [1, 1])}
    dataset = xr.Dataset(sizes)
    assert step_labels(dataset) == ["0.2 µm", "1 µm"]
    two = dataset.assign(step_mode=("step", [1, 2]))
    assert step_labels(two) == ["mode 1, 0.2 µm", "mode 2, 1 µm"]


def test_steps_of_a_path_have_its_numbers():
    path = xr.Dataset({"path_step": ("step", [0, 1, -1])}).assign_coords(step=[3, 6, 9])
    assert step_labels(path) == ["step 0", "step 1", "last cycle"]


def test_seconds_and_per_cent_have_bars_of_their_size(axes):
    sources = [("fit", 0.04, 12.0), ("small slopes", 0.01, np.nan)]
    ax = plot_costs({"micro_response": 30.0, "macro_result": 5.0}, sources, ax=axes)
    (percent,) = [other for other in ax.figure.axes if other is not ax]
    np.testing.assert_allclose([bar.get_width() for bar in ax.patches], [30.0, 5.0])
    np.testing.assert_allclose([bar.get_width() for bar in percent.patches], [4.0, 1.0])
    captions = [text.get_text().strip() for text in percent.texts]
    assert captions == ["halved in 12 s", "no setting reduces it"]
    names = [label.get_text() for label in ax.get_yticklabels()]
    assert names == ["micro response", "macro result", "fit", "small slopes"]
