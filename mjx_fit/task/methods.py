"""The methods that the experiments compare: what each of them learns from a failed attempt."""

from dataclasses import dataclass

from mjx_fit.errors import RequestError


@dataclass(frozen=True)
class Method:
    """A way to act on failures. All of them learn from the failure itself (the outcome model T).

    Attributes:
        name: As in commands and files.
        learns_position: Whether the trace updates the belief about the position.
        learns_type: Whether the trace updates the belief about the type.
        knows_truth: Whether it starts with the true positions and types: a bound that nobody can beat.
    """

    name: str
    learns_position: bool = False
    learns_type: bool = False
    knows_truth: bool = False

    @property
    def needs_sensor(self) -> bool:
        return self.learns_position or self.learns_type


ASSEMBLY = (
    Method("failure_only"),
    Method("failure_position", learns_position=True),
    Method("full", learns_position=True, learns_type=True),
    Method("oracle", knows_truth=True),
)


def chosen(names: str) -> tuple[Method, ...]:
    """The methods that a comma-separated list names, each once.

    Raises:
        RequestError: One of them does not exist.
    """
    known = {method.name: method for method in ASSEMBLY}
    picked = {}
    for name in names.split(","):
        if name not in known:
            raise RequestError(f"--methods: {name!r} is not allowed: choose from {', '.join(known)}")
        picked[name] = known[name]
    return tuple(picked.values())
