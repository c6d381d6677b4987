"""Checks of bodies against the other tables of their case."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from multiscale.pipeline.tables import assembly_parts

if TYPE_CHECKING:
    from multiscale.pipeline.tables.settings import Case


def check_bodies(bodies: Sequence[assembly_parts.MeshedBody], case: "Case") -> None:
    """Refuse bodies without the data that the other tables of their case need."""
    takers = [body.name for body in bodies if body.porous and body.rve is None]
    if takers and case.rve is None:
        raise ValueError(
            f"{takers[0]} has neither moduli nor rve, and the case has no [rve]; give one of them"
        )
    if case.rve is not None and not takers and case.growth is None:
        raise ValueError(
            "every body has moduli or rve, and so no body takes the [rve] of this case"
        )
    without = [body.name for body in bodies if body.density is None]
    if case.vibration is not None and without:
        raise ValueError(
            f"[vibration] needs the mass of all bodies, and {without[0]} has no density; give it, "
            f'such as "7850 kg/m^3"'
        )
    if case.fatigue is not None:
        _check_fatigue(bodies, case)
    if (method := case.statics.method) is None:
        return
    for table in ("vibration", "growth"):
        if getattr(case, table) is not None:
            raise ValueError(
                f'method = "{method}" in [statics] is not for [{table}], which has a different '
                f"solver; leave out method"
            )
    if method != "latin" and case.substructures is not None:
        raise ValueError(
            f'method = "{method}" in [statics] solves the whole structure, and [substructures] cut '
            f"it for LATIN; leave out one of them"
        )


def _check_fatigue(bodies: Sequence[assembly_parts.MeshedBody], case: "Case") -> None:
    """Refuse a history without a cycle, and a body that does not exist."""
    if case.cycles is None:
        raise ValueError(
            "[fatigue] repeats the last cycle of the loads, and the history has no cycle; give "
            "[cycles]"
        )
    names = [body.name for body in bodies]
    if case.fatigue.body is None and len(names) > 1:
        raise ValueError(
            f"[fatigue] follows one body, and there are {', '.join(names)}; name one by body"
        )
    if case.fatigue.body not in (None, *names):
        raise ValueError(
            f"[fatigue] body is {case.fatigue.body!r}, and there are {', '.join(names)}"
        )
    followed = bodies[names.index(case.fatigue.body or names[0])]
    if followed.porous:
        raise ValueError(
            f"[fatigue] follows {followed.name}, and its inclusions need moduli; give it "
            f"youngs_modulus and poissons_ratio in place of a representative volume"
        )
