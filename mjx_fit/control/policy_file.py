"""Custom policies: load them from a Python file, and check them before anything is simulated."""

import hashlib
import re
import sys
from collections.abc import Callable
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import jax
import jax.numpy as jnp

from mjx_fit.control.policies import Policy, PolicyInput, PolicyStart, stateless
from mjx_fit.jobs.pool import USER_MODULES
from mjx_fit.types import Array, Reading
from mjx_fit.utils import numerics
from mjx_fit.utils.errors import RequestError, shortened, shown
from mjx_fit.utils.rates import SUBSTEPS

NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,39}(@[0-9a-f]{12})?")
"""Pattern of the policy names allowed in data sets and results."""
_FORM = re.compile(r"(?P<path>.+\.py):(?P<name>[A-Za-z_][A-Za-z0-9_]{0,39})")


def is_policy_file(text: str) -> bool:
    """Return whether an option means a policy in a file, ``FILE.py:NAME``."""
    return _FORM.fullmatch(text) is not None


def load_policy(text: str) -> Policy:
    """Load a policy from a Python file.

    Args:
        text: ``FILE.py:NAME``. NAME is a ``Policy``, or a function from ``PolicyInput`` to a command.
            ``require_policy`` checks the result.

    Returns:
        The policy, named ``NAME@HASH`` with the first 12 digits of the file's SHA-256.

    Raises:
        RequestError: The file cannot be read or run, has no such name, or the name is not a policy.
    """
    form = _FORM.fullmatch(text)
    if form is None:
        raise RequestError(f"--policy: {shown(text)} is invalid: expected FILE.py:NAME")
    path, name = Path(form["path"]).expanduser(), form["name"]
    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise RequestError(f"--policy: {path} cannot be read: {error.strerror}") from None
    found: Any = getattr(_module(path), name, None)
    if found is None:
        raise RequestError(f"--policy: {path} has no {name}")
    if isinstance(found, Policy):
        policy = found
    elif callable(found) and not isinstance(found, type):  # a jitted or partial function, too
        policy = stateless(cast("Callable[[PolicyInput], Array]", found))
    else:
        raise RequestError(
            f"--policy: {name} of {path} is {shown(found)}: expected a Policy, or a function of PolicyInput"
        )
    return policy._replace(name=f"{name}@{digest[:12]}")


def require_policy(policy: Policy) -> None:
    """Check that a policy can be traced by JAX, and gives a command and a state that keeps its form.

    Raises:
        RequestError: It does not; the message says where.
    """
    name = policy.name or "the policy"
    if policy.name and NAME.fullmatch(policy.name) is None:
        raise RequestError(f"--policy: name {shown(policy.name)} is invalid: expected letters, digits and _")
    try:
        seen = _seen(reads=policy.reads)
        state = jax.eval_shape(policy.init, seen.start, seen.key)
        after, command = jax.eval_shape(policy.act, state, seen)
        if policy.report is not None:
            jax.eval_shape(policy.report, after)
        ends = _of(dtype=jnp.bool_) if policy.gives_up is None else jax.eval_shape(policy.gives_up, after)
    except Exception as error:  # the user's code may raise anything
        raise RequestError(f"--policy: {name} cannot be used: {_said(error)}") from None
    if jnp.shape(command) != (policy.width,) or not jnp.issubdtype(command.dtype, jnp.floating):
        found = f"{getattr(command, 'dtype', type(command).__name__)} {jnp.shape(command)}"
        unit = "m and rad" if policy.turns else "m"
        raise RequestError(
            f"--policy: the command of {name} is {found}: expected floats ({policy.width},), in {unit}"
        )
    if jnp.shape(ends) != () or ends.dtype != jnp.bool_:
        found = f"{getattr(ends, 'dtype', type(ends).__name__)} {jnp.shape(ends)}"
        raise RequestError(f"--policy: gives_up of {name} is {found}: expected one bool")
    if _form(state) != _form(after):
        raise RequestError(
            f"--policy: the state of {name} changes from {_form(state)[1]} to {_form(after)[1]}: "
            "expected the same structure, shapes and types"
        )


def _module(path: Path) -> ModuleType:
    spec = spec_from_file_location(f"{USER_MODULES}{path.stem}", path)
    if spec is None or spec.loader is None:
        raise RequestError(f"--policy: {path} is no Python file")
    module = module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:  # the user's code may raise anything
        raise RequestError(f"--policy: {path} cannot be run: {_said(error)}") from None
    return module


def _said(error: BaseException) -> str:
    words = str(error).strip().partition("\n")[0]
    return f"{type(error).__name__}: {shortened(words, 200)}" if words else type(error).__name__


def _form(state: Any) -> tuple[Any, list[str]]:
    leaves, structure = jax.tree.flatten(state)
    return structure, [f"{leaf.dtype}{list(leaf.shape)}" for leaf in leaves]


def _of(*shape: int, dtype: Any = jnp.float32) -> Any:
    return jax.ShapeDtypeStruct(shape, dtype)


def _seen(*, reads: bool) -> PolicyInput:
    """Return the shapes and types of a policy's input."""
    key = jax.eval_shape(lambda: numerics.key(0))
    return PolicyInput(
        start=PolicyStart(_of(dtype=jnp.int32), _of(2), _of(dtype=jnp.int32)),
        attempt_key=key,
        key=key,
        step=_of(dtype=jnp.int32),
        tip_pos_world=_of(3),
        tip_quat_world=_of(4),
        tip_linvel_world=_of(3),
        tip_angvel_world=_of(3),
        wrench_sensor=_of(SUBSTEPS, 6),
        contact=_of(dtype=jnp.bool_),
        horizon=100,
        reading=_row() if reads else None,
    )


def _row() -> Reading:
    """Return the shapes and types of a reading of one action."""
    return Reading(
        wrench_sensor=_of(1, SUBSTEPS, 6),
        pressure_tip=_of(1, 2),
        tip_pos_estimate=_of(1, 3),
        tip_quat_world=_of(1, 4),
        tip_linvel_world=_of(1, 3),
        tip_angvel_world=_of(1, 3),
        contact=_of(1),
        action_world=_of(1, 3),
        mask=_of(1, dtype=jnp.bool_),
        peg_type=_of(dtype=jnp.int32),
    )
