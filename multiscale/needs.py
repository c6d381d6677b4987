"""What a scene needs: the only input from which solvers allocate and choose."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

__all__ = ["Needs", "choose", "join_needs"]


def choose(
    choices: Mapping[str, tuple[bool, str, str]],
) -> tuple[dict[str, str], dict[str, str]]:
    """Split operators into those that are built and those that are left out.

    Parameters
    ----------
    choices : mapping of str to (bool, str, str)
        Of every operator: whether it is needed, what for, and why not.

    Returns
    -------
    operators, left_out : dict of str to str
        As :class:`Needs` takes them.
    """
    operators = {name: why for name, (needed, why, _) in choices.items() if needed}
    return operators, {name: why for name, (needed, _, why) in choices.items() if not needed}


@dataclass(frozen=True)
class Needs:
    """What one scene uses, and nothing else.

    Attributes
    ----------
    unknowns_per_contact : int
        1 without friction, 3 with it.
    kinematics : str
        For instance ``"small strain, the mesh follows the surface"``.
    operators : dict of str to str
        What is built, and what for.
    left_out : dict of str to str
        What other scenes build and this one does not, and why not.
    state_variables : tuple of str
        History kept at each point; none for an elastic scene.
    fields : tuple of str
        Local fields kept in the result.
    libraries : tuple of str
        Heavy libraries that are imported.
    memory : int
        Estimated peak memory of the largest solve, byte.
    """

    unknowns_per_contact: int = 1
    kinematics: str = ""
    operators: dict[str, str] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    state_variables: tuple[str, ...] = ()
    fields: tuple[str, ...] = ()
    libraries: tuple[str, ...] = ()
    memory: int = 0

    def __contains__(self, operator: str) -> bool:
        """Whether an operator is to be built."""
        if operator not in self.operators and operator not in self.left_out:
            raise KeyError(operator)
        return operator in self.operators

    def explain(self) -> str:
        """Return the needs as text, one line each."""
        rows = [
            ("assumes", self.kinematics),
            ("unknowns per contact", str(self.unknowns_per_contact)),
            ("history kept", ", ".join(self.state_variables) or "none"),
            ("fields kept", ", ".join(self.fields) or "none"),
            ("libraries", ", ".join(self.libraries)),
            ("memory", f"{self.memory / 1e6:.3g} MB for the largest solve"),
            *((f"builds {name}", reason) for name, reason in self.operators.items()),
            *((f"leaves out {name}", reason) for name, reason in self.left_out.items()),
        ]
        width = max(len(name) for name, _ in rows)
        return "\n".join(f"{name:{width}}  {value}" for name, value in rows)


def join_needs(parts: Iterable[Needs]) -> Needs:
    """Join the needs of stages that run one after another: the largest memory counts.

    Parameters
    ----------
    parts : iterable of Needs
        At least one, and one of them with kinematics.
    """
    parts = list(parts)
    return Needs(
        unknowns_per_contact=max(part.unknowns_per_contact for part in parts),
        kinematics="; ".join(part.kinematics for part in parts if part.kinematics),
        operators={name: why for part in parts for name, why in part.operators.items()},
        left_out={name: why for part in parts for name, why in part.left_out.items()},
        state_variables=tuple(name for part in parts for name in part.state_variables),
        fields=tuple(name for part in parts for name in part.fields),
        libraries=tuple(sorted({name for part in parts for name in part.libraries})),
        memory=max(part.memory for part in parts),
    )
