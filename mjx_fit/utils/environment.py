"""What the environment asks of JAX, NumPy and MuJoCo, looked at before they are imported.

They meet a value that they do not know with a traceback, or by ending the process. A command names the
variable instead.
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
    """Shows warnings that were to be errors: what one library says of another one fails no command."""
    if any(option.startswith("e") for option in sys.warnoptions):
        warnings.simplefilter("default")


def draw_nothing() -> None:
    """Lets MuJoCo load no OpenGL, which may be missing or named wrongly: the command draws nothing.

    MuJoCo decides when it is imported. ``for_children`` gives the variable back.
    """
    if "mujoco" not in sys.modules:
        _hidden[_GL] = os.environ.get(_GL)
        os.environ[_GL] = "disable"


def for_children() -> dict[str, str]:
    """The environment as the user set it."""
    own = dict(os.environ)
    for name, value in _hidden.items():
        own.pop(name, None)
        if value is not None:
            own[name] = value
    return own


def require(computes: bool) -> None:
    """Checks what JAX and NumPy are asked for by the environment.

    Args:
        computes: Whether JAX's device is needed.

    Raises:
        RequestError: They cannot start with it; names the variable.
    """
    if "jax" not in sys.modules:
        _require_flags()
    try:
        import jax

        if computes:
            jax.device_put(1.0).block_until_ready()
    except ImportError:
        raise
    except Exception as error:  # whatever it is: its cause stands in a variable, or it is raised again
        refusal = blame(error)
        raise error if refusal is None else refusal from None


def blame(error: Exception) -> RequestError | None:
    """What to say of an error of JAX or NumPy that a variable of the environment caused; None: none did.

    They name the variable, or quote its value; JAX without the device that it was asked for may say nothing.
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
        said = said.partition(" (set JAX_PLATFORMS")[0] or "JAX finds no such device"
    return RequestError(
        f"{name}: {os.environ[name]!r} cannot be used here: {said[:300]}; correct it or unset it"
    )


def _require_flags() -> None:
    """XLA ends the process at a flag that it does not know: a process of its own tries them, once."""
    flags = os.environ.get("XLA_FLAGS", "").strip()
    if not flags:
        return
    asked = hashlib.sha256(f"{version('jaxlib')} {flags}".encode(errors="replace")).hexdigest()
    known = CACHE / "xla_flags" / asked
    if flags.startswith("-") and known.exists():  # a file of flags may hold others by now
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
