"""Checks of bodies against the other tables of their case."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from multiscale.pipeline.tables import assembly_parts

if TYPE_CHECKING:
    from multiscale.pipeline.tables.settings import Case


def body_faults(bodies: Sequence[assembly_parts.MeshedBody], case: "Case") -> Iterator[str]:
    """Report bodies without the data that the other tables of their case need."""
    takers = [body.name for body in bodies if body.porous and body.rve is None]
    if takers and case.rve is None:
        yield f"{takers[0]} has neither moduli nor rve, and the case has no [rve]; give one of them"
    if case.rve is not None and not takers and case.growth is None:
        yield "every body has moduli or rve, and so no body takes the [rve] of this case"
    without = [body.name for body in bodies if body.density is None]
    if case.vibration is not None and without:
        yield (
            f"[vibration] needs the mass of all bodies, and {without[0]} has no density; give it, "
            f'such as "7850 kg/m^3"'
        )
    if case.fatigue is not None:
        yield from _fatigue_faults(bodies, case)
    if (method := case.statics.method) is None:
        return
    for table in ("vibration", "growth"):
        if getattr(case, table) is not None:
            yield (
                f'method = "{method}" in [statics] is not for [{table}], which has a different '
                f"solver; leave out method"
            )
    if method != "latin" and case.substructures is not None:
        yield (
            f'method = "{method}" in [statics] solves the whole structure, and [substructures] cut '
            f"it for LATIN; leave out one of them"
        )


def _fatigue_faults(bodies: Sequence[assembly_parts.MeshedBody], case: "Case") -> Iterator[str]:
    """Report a history without a cycle, and a body that does not exist."""
    if case.cycles is None:
        yield (
            "[fatigue] repeats the last cycle of the loads, and the history has no cycle; give "
            "[cycles]"
        )
    names = [body.name for body in bodies]
    if case.fatigue.body is None and len(names) > 1:
        yield f"[fatigue] follows one body, and there are {', '.join(names)}; name one by body"
    if case.fatigue.body not in (None, *names):
        yield f"[fatigue] body is {case.fatigue.body!r}, and there are {', '.join(names)}"
    followed = bodies[names.index(case.fatigue.body or names[0])]
    if followed.porous:
        yield (
            f"[fatigue] follows {followed.name}, and its inclusions need moduli; give it "
            f"youngs_modulus and poissons_ratio in place of a representative volume"
        )
