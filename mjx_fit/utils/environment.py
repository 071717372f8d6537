"""Checks of environment variables for JAX, NumPy and MuJoCo before these are imported.

The libraries react to unknown values with a traceback or by ending the process. Commands name the variable
instead.
"""

import contextlib
import hashlib
import os
import subprocess
import sys
import warnings
from importlib.metadata import version

from mjx_fit.utils.compilation_cache import CACHE
from mjx_fit.utils.errors import RequestError

_WATCHED = ("JAX_", "XLA_", "NPY_")
_DEVICES = ("JAX_PLATFORMS", "JAX_PLATFORM_NAME", "JAX_DEFAULT_DEVICE")
_GL = "MUJOCO_GL"
_hidden: dict[str, str | None] = {}


def relax_warnings() -> None:
    """Show warnings that Python was asked to raise: one library's warning about another fails no command."""
    if any(option.startswith("e") for option in sys.warnoptions):
        warnings.simplefilter("default")


def draw_nothing() -> None:
    """Keep MuJoCo from loading OpenGL, which may be missing or misconfigured, for commands without graphics.

    MuJoCo decides this on import. ``for_children`` restores the variable.
    """
    if "mujoco" not in sys.modules:
        _hidden[_GL] = os.environ.get(_GL)
        os.environ[_GL] = "disable"


def for_children() -> dict[str, str]:
    """Return the user's original environment."""
    own = dict(os.environ)
    for name, value in _hidden.items():
        own.pop(name, None)
        if value is not None:
            own[name] = value
    return own


def require(computes: bool) -> None:
    """Check that JAX and NumPy can start in this environment.

    Args:
        computes: True if JAX's device is needed.

    Raises:
        RequestError: They cannot start; the message names the variable.
    """
    if "jax" not in sys.modules:
        _require_flags()
    try:
        import jax

        if computes:
            jax.device_put(1.0).block_until_ready()
    except ImportError:
        raise
    except Exception as error:  # blame a variable, or raise it again
        refusal = blame(error)
        raise error if refusal is None else refusal from None


def blame(error: Exception) -> RequestError | None:
    """Attribute an error of JAX or NumPy to an environment variable; None if no variable caused it.

    Such errors name the variable or quote its value; JAX may give no reason if a requested device is missing.
    """
    text = f"{error} {error!r}"
    there = [name for name in os.environ if name.startswith(_WATCHED) and os.environ[name]]
    named = [name for name in there if name in text or name.lower() in text]
    quoted = [name for name in there if len(os.environ[name]) > 2 and os.environ[name] in text]
    likely = [name for name in _DEVICES if name in there]
    name = next(iter([*named, *quoted, *likely]), None)
    if name is None:
        return None
    said = str(error).strip().partition("\n")[0]
    if name in _DEVICES:
        said = said.partition(" (set JAX_PLATFORMS")[0] or "JAX does not find this device"
    return RequestError(
        f"{name}: {os.environ[name]!r} cannot be used here: {said[:300]}; correct it or unset it"
    )


def _require_flags() -> None:
    """Try XLA's flags once in a separate process, since XLA ends the process if a flag is unknown."""
    flags = os.environ.get("XLA_FLAGS", "").strip()
    if not flags:
        return
    asked = hashlib.sha256(f"{version('jaxlib')} {flags}".encode(errors="replace")).hexdigest()
    known = CACHE / "xla_flags" / asked
    if flags.startswith("-") and known.exists():  # a file of flags may have changed
        return
    others = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    tried = subprocess.run(
        [sys.executable, "-c", "import jax; jax.device_put(1.0).block_until_ready()"],
        env=others | {"JAX_PLATFORMS": "cpu"},
        capture_output=True,
        text=True,
        errors="replace",
        stdin=subprocess.DEVNULL,
        check=False,
    )
    if tried.returncode:
        said = [line.partition("] ")[2] for line in tried.stderr.splitlines() if line[:1] in ("E", "F")]
        why = next(filter(None, said), "XLA cannot start with it")
        raise RequestError(f"XLA_FLAGS: {flags!r} cannot be used: {why}")
    if CACHE.is_absolute():
        with contextlib.suppress(OSError):
            known.parent.mkdir(parents=True, exist_ok=True)
            known.touch()
