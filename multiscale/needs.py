"""Needs of a scene in words: features that are built or left out, and why."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import isnan, nan


def readable_time(seconds: float) -> str:
    """Format a time in its most readable unit."""
    for unit, length in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 1.5 * length:
            return f"{float(f'{seconds / length:.3g}'):.12g} {unit}"
    return f"{seconds:.2g} s"


def _readable_memory(size: int) -> str:
    return f"{size / 1e6:.3g} MB" if size < 1e9 else f"{size / 1e9:.3g} GB"


@dataclass(frozen=True)
class Choice:
    """Whether a feature is built, and why; areas with several name them in a ``StrEnum``."""

    part: str
    why: str
    built: bool = True


def choose(part: str, built: bool, why: str, why_not: str) -> Choice:
    """Return the choice of a feature with the reason that applies."""
    return Choice(part, why if built else why_not, built)


@dataclass(frozen=True)
class Cost:
    """Cost of a stage."""

    stage: str
    memory: int  # estimated peak of its largest solve, byte
    seconds: float  # estimated time on one core, s; NaN without an estimate

    def __str__(self) -> str:
        """Return the cost in words, as far as it is estimated."""
        time = "" if isnan(self.seconds) else f"about {readable_time(self.seconds)} on one core"
        size = _readable_memory(self.memory) if self.memory else ""
        return ", ".join(filter(None, (time, size))) or "not estimated"


@dataclass(frozen=True)
class Needs:
    """Needs of a single scene, for a reader; solvers use the cell, structure or options."""

    unknowns_per_contact: int = 1  # 3 with friction
    kinematics: str = ""  # such as "small strain, the mesh follows the surface"
    choices: tuple[Choice, ...] = ()  # features that are built, and features of other scenes
    state_variables: tuple[str, ...] = ()  # of each point; empty for an elastic scene
    fields: tuple[str, ...] = ()  # local fields of the result
    libraries: tuple[str, ...] = ()  # heavy libraries that are imported
    memory: int = 0  # estimated peak of the largest solve, byte
    seconds: float = nan  # estimated time on one core, s; NaN without an estimate
    costs: tuple[Cost, ...] = ()  # of stages, of a case that has several

    @property
    def built(self) -> dict[str, str]:
        """Reason of each feature that is built."""
        return {choice.part: choice.why for choice in self.choices if choice.built}

    @property
    def omitted(self) -> dict[str, str]:
        """Reason of each feature that is left out."""
        return {choice.part: choice.why for choice in self.choices if not choice.built}

    def explain(self) -> str:
        """Return the needs as text, with a line for each."""
        rows = [
            ("assumes", self.kinematics),
            ("unknowns per contact", str(self.unknowns_per_contact)),
            ("internal variables", ", ".join(self.state_variables) or "none"),
            ("stored fields", ", ".join(self.fields) or "none"),
            ("libraries", ", ".join(self.libraries)),
            ("memory", f"{_readable_memory(self.memory)} for the largest solve"),
            *((f"cost of {cost.stage}", str(cost)) for cost in self.costs),
            *((f"builds {part}", reason) for part, reason in self.built.items()),
            *((f"leaves out {part}", reason) for part, reason in self.omitted.items()),
        ]
        width = max(len(name) for name, _ in rows)
        return "\n".join(f"{name:{width}}  {value}" for name, value in rows)


def join_needs(stages: Iterable[Needs]) -> Needs:
    """Join the needs of stages that run one after another: the largest memory counts."""
    stages = list(stages)
    return Needs(
        unknowns_per_contact=max(stage.unknowns_per_contact for stage in stages),
        kinematics="; ".join(stage.kinematics for stage in stages if stage.kinematics),
        choices=tuple(choice for stage in stages for choice in stage.choices),
        state_variables=tuple(name for stage in stages for name in stage.state_variables),
        fields=tuple(name for stage in stages for name in stage.fields),
        libraries=tuple(sorted({name for stage in stages for name in stage.libraries})),
        memory=max(stage.memory for stage in stages),
    )
