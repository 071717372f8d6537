"""Which OpenGL MuJoCo draws with: it decides when it is imported, and crashes where there is none."""

import os
import subprocess
import sys

from mjx_fit.utils.errors import RequestError

BACKENDS = ("egl", "osmesa", "glfw")
_DRAW = """
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco/>")
with mujoco.Renderer(model, 8, 8) as renderer:
    renderer.update_scene(mujoco.MjData(model))
    renderer.render()
"""
"""In a process of its own: a missing library may end it."""

_MISSING = (
    "MUJOCO_GL: {} cannot be used: nothing can be drawn with it here; install EGL (Debian: libegl1 and "
    "libgl1-mesa-dri) or OSMesa (libosmesa6), or draw on a machine with a display"
)


def choose() -> None:
    """Chooses what draws without a window, for the rest of the process; call it before MuJoCo is imported.

    What ``MUJOCO_GL`` asks for is kept, if it can draw.

    Raises:
        RequestError: Nothing here can draw.
    """
    asked = os.environ.get("MUJOCO_GL", "").lower()
    for backend in (asked,) if asked else BACKENDS:
        if draws(backend):
            os.environ["MUJOCO_GL"] = backend
            return
    raise RequestError(_MISSING.format(repr(asked) if asked else f"any of {', '.join(BACKENDS)}"))


def draws(backend: str) -> bool:
    """Whether MuJoCo can draw with a backend here."""
    try:
        found = subprocess.run(
            [sys.executable, "-c", _DRAW],
            env=os.environ | {"MUJOCO_GL": backend},
            capture_output=True,
            timeout=60,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False
    return found.returncode == 0
