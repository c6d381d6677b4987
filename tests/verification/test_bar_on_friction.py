r"""A bar that is pressed on a rigid ground and pulled at its end.

With the friction :math:`q = \mu p w` per length, a force F below its full friction slips over
the length :math:`F / q`. End displacement and loss of a cycle of rigid-plastic friction are

.. math:: u = \frac{F^2}{2 E A q}, \qquad W = \frac{2 F^3}{3 E A q}.

C.-H. Menq, J. Bielak, J. H. Griffin, J. Sound Vib. 107 (1986) 279-293,
doi:10.1016/0022-460X(86)90238-5.
"""

import numpy as np
import pytest

from multiscale.fe.mesh_file import box_mesh
from multiscale.laws import Exponential, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import (
    AssembledNewton,
    Assembly,
    Body,
    Interface,
    NewtonSchur,
    solve_assembly,
)
from multiscale.macro.substructures import joint_path, load_joint

E, LENGTH, WIDTH, HEIGHT = 210e9, 1.0, 0.01, 0.002
PRESSURE, MU, SLIPS = 1e6, 0.3, 0.57  # Pa, 1, share of the length
FRICTION, STIFFNESS = MU * PRESSURE * WIDTH, E * WIDTH * HEIGHT  # N/m, N
FORCE = SLIPS * FRICTION * LENGTH
SHEAR = FORCE / (WIDTH * HEIGHT)  # Pa at the end
METHOD = AssembledNewton()


def bar(elements, decay=1e-7):
    """On friction so stiff that it sticks within a hundredth of the length."""
    law = Sliders(Exponential(1e9, decay), MU, pressures=(1e5, 1e7), slabs=8)
    body = Body(
        box_mesh((LENGTH, WIDTH, HEIGHT), (elements, 1, 1)),
        Elastic(E, 0.0),
        supports={"front": (None, 0.0, None)},
        tractions={
            "top": (0.0, 0.0, lambda x, time: np.full(x.shape[1], time - 1.0)),
            "right": (1.0, 0.0, 0.0),
        },
    )
    ground = Interface((None, 0), (None, "bottom"), law)
    return Assembly((body,), (ground,), (0.0, 1.0), (LENGTH * WIDTH, WIDTH * HEIGHT))


def test_the_end_moves_by_the_closed_form():
    steps = np.column_stack([np.full(9, PRESSURE), SHEAR * np.linspace(0.0, 1.0, 9)])
    errors = []
    for elements in (10, 20, 40):
        result = solve_assembly(bar(elements), steps, method=METHOD)
        end = np.isclose(result.position.values[:, 0], LENGTH)
        moved = result.displacement.values[-1, end, 0].mean()
        errors.append(abs(moved / (FORCE**2 / (2.0 * STIFFNESS * FRICTION)) - 1.0))
        x, slipped = result.point_position.values[:, 0], result.jump.values[-1, :, 1:]
        far = np.hypot(*slipped.T) > 1e-3 * moved
        assert abs((LENGTH - x[far].min()) / (FORCE / FRICTION) - 1.0) < 2.0 / elements / SLIPS
    assert errors[0] < 0.01
    assert errors[2] < 0.7 * errors[1] < 0.7**2 * errors[0]


def test_a_cycle_dissipates_the_cube_of_the_force():
    result = load_joint(bar(20), joint_path((PRESSURE,), SHEAR, 1, 8), method=METHOD)
    lost = 2.0 * FORCE**3 / (3.0 * STIFFNESS * FRICTION)
    assert result.cycle_energy.item() == pytest.approx(lost, rel=0.01)


@pytest.mark.parametrize("elements", [10, 20])
@pytest.mark.parametrize("decay", [1e-8, 1e-10])
@pytest.mark.parametrize("method", [AssembledNewton(), NewtonSchur((2, 1))], ids=["whole", "cut"])
def test_newton_solves_friction_of_any_stiffness_on_coarse_meshes(method, decay, elements):
    steps = np.column_stack([np.full(5, PRESSURE), SHEAR * np.linspace(0.0, 1.0, 5)])
    result = solve_assembly(bar(elements, decay), steps, method=method)
    assert result.converged.values.all()
    assert result.iterations.values.max() <= 15
    end = np.isclose(result.position.values[:, 0], LENGTH)
    moved = result.displacement.values[-1, end, 0].mean()
    assert moved == pytest.approx(FORCE**2 / (2.0 * STIFFNESS * FRICTION), rel=0.02)
