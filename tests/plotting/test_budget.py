"""The bars of an error budget are as high as its totals and name what is missing."""

import matplotlib as mpl
import numpy as np
import pytest

from multiscale.plotting import plot_error_budget
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
    for container in ax.containers:
        for k, bar in enumerate(container):
            if len(container) == 8:
                top[k] = max(top[k], bar.get_y() + bar.get_height())
    total = budget["error_total"].sel(quantity="stiffness").values
    np.testing.assert_allclose(top, 100.0 * total)
    assert sum(len(container) == 8 for container in ax.containers) == 2
    names = [text.get_text() for text in ax.get_legend().get_texts()]
    assert names[:2] == ["sampling", "fit"]
    assert "scale separation: not known" in names
    assert ax.get_ylabel() == "95 % half-width of stiffness (%)"
    assert ax.get_xticklabels()[0].get_text() == "5"


def test_a_total_that_lacks_a_term_is_no_bar_but_the_word_unknown(axes):
    response = response_of(exponential_gaps(1))
    ax = plot_error_budget(error_budget(response, fit_law(response)), ax=axes)
    assert [text.get_text() for text in ax.texts] == 8 * ["unknown"]
    assert max(bar.get_height() for bar in ax.patches) == 0.0
