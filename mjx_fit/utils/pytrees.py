"""Frozen dataclasses that are JAX pytrees."""

from dataclasses import dataclass, field
from typing import Any, TypeVar, dataclass_transform

import jax

T = TypeVar("T")


def static() -> Any:
    """Declare a static ``pytree`` field: a Python value known at trace time, not a child."""
    return field(metadata={"static": True})


@dataclass_transform(frozen_default=True, field_specifiers=(static,))
def pytree(cls: type[T]) -> type[T]:
    """Make a class a frozen dataclass and a JAX pytree whose children are all fields but ``static`` ones."""
    return jax.tree_util.register_dataclass(dataclass(frozen=True)(cls))
