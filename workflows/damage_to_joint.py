"""Compute stiffness and life of a joint of cast blocks with pores under cyclic pressure.

The blocks of the joint have the effective stiffness of a volume with pores, which is not the damage
on plane sections (eq (1)). The stress of the weakest section, cycled far below the yield stress,
makes weak inclusions flow until they crack, one after the other, and reduce the section by their
shares. The law of the interface comes from elastic cells of milled faces with a given
roughness. In cases, [fatigue] does the same for the elements of bodies.

    python workflows/damage_to_joint.py -o damage [--quick]

leaves datasets (``damage_sections.nc``, ``woehler.nc``, ``fatigue_life.nc``, ``interface_law.nc``,
``macro_result.nc``) and figures. ``--quick`` is coarser.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from multiscale import micro, schema
from multiscale.io import make_folder, write_dataset
from multiscale.macro import Block, RoughJoint, press_joint, soften
from multiscale.micro.damage import (
    FatigueMaterial,
    effective_stiffness,
    local_fatigue,
    max_damage,
    random_spheres,
    voxelise,
    woehler_curve,
    youngs_modulus_along,
)
from multiscale.plotting import plot_damage_sphere, plot_woehler, plot_worst_section
from multiscale.plotting.figure import in_space, on_axes
from multiscale.upscaling import fit_law, law_from_dataset

E, NU = 71e9, 0.33  # cast aluminium
PRESSURE = (5e6, 130e6)
"""Nominal pressure between which the joint is cycled, Pa."""
FACE = {"rms_height": 5.7e-6, "hurst_exponent": 0.8, "long_cutoff": 4e-4, "short_cutoff": 1e-4}
"""Sum of two milled faces of 4 um."""


def main(argv: Sequence[str] | None = None) -> int:
    """Compute the life of a joint from its pores; write and draw every step."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, default=Path("damage"))
    parser.add_argument("--quick", action="store_true", help="coarse images, few sections")
    arguments = parser.parse_args(argv)
    out, quick = make_folder(arguments.out), arguments.quick

    pores = random_spheres((1e-3, 1e-3, 1e-3), 1.2e-4, porosity=0.06, seed=4)
    sections = max_damage(pores, level=1 if quick else 2, sections=17 if quick else 65)
    image = voxelise(pores, 24 if quick else 64)
    stiffness = effective_stiffness(image, E, NU).unwrap()
    damage = float(sections["maximum_damage"])
    factor = float(youngs_modulus_along(stiffness, np.eye(3)[2])) / E

    material = FatigueMaterial(E, NU, 70e6, 0.2e6, 1.5, hardening=5e9, threshold=0.02, closure=0.2)
    curve = woehler_curve(material, np.array([65e6, 71e6, 74e6, 80e6, 90e6, 110e6]))
    stress = -np.array(PRESSURE)[::-1, None, None] * np.eye(6)[2] / (1.0 - damage)
    left = lambda cracked: stress / (1.0 - cracked[:, None])  # noqa: E731
    life = local_fatigue(left, 1, material, scatter=0.03)

    size = (1.6e-3, 1.6e-3)
    faces = [micro.self_affine((64, 64), size, k, **FACE) for k in range(3 if quick else 12)]
    # half the modulus: both faces deform
    cells = [micro.Cell(face, size[0], 8, 0.5 * E, NU, geometry="flat") for face in faces]
    path = micro.Path(pressure=tuple(np.geomspace(2.5e6, 260e6, 10)))
    law = fit_law(micro.run_ensemble(cells, path))
    block = soften(Block(0.02, E, NU), stiffness)
    rough = RoughJoint((0.05, 0.05), block, block)
    joint = press_joint(rough, law_from_dataset(law), np.array([PRESSURE[0]]))

    kinds = (schema.DAMAGE_SECTIONS, schema.WOEHLER, schema.FATIGUE_LIFE)
    kinds = (*kinds, schema.INTERFACE_LAW, schema.MACRO_RESULT)
    for kind, dataset in zip(kinds, (sections, curve, life, law, joint), strict=True):
        write_dataset(dataset, out / f"{kind.name}.nc", kind)
    figures = {
        "damage_sphere": in_space(plot_damage_sphere, sections),
        "worst_section": on_axes(plot_worst_section, pores, sections),
        "woehler": on_axes(plot_woehler, curve),
    }
    for name, draw in figures.items():
        draw(make_folder(out / "figures") / f"{name}.png")
    cracks = [float(life[f"cycles_to_{name}"]) for name in ("first", "crack")]
    sys.stdout.write(
        f"porosity {image.porosity:.3f}, damage of the worst section {damage:.3f}, "
        f"stiffness lost along z {1.0 - factor:.3f}\n"
        f"stiffness of the joint {1e-12 * float(joint['joint_stiffness'][0]):.3f} MPa/um, cycles "
        f"to the first inclusion with a crack {cracks[0]:.4g}, to the last {cracks[1]:.4g}\n"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
