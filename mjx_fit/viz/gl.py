"""Choice of MuJoCo's OpenGL backend: MuJoCo chooses at import, and crashes if the backend is missing."""

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
"""Script of a separate process, since a missing library may abort it."""

_MISSING = (
    "MUJOCO_GL: {} cannot be used: rendering fails on this machine; install EGL (Debian: libegl1 and "
    "libgl1-mesa-dri) or OSMesa (libosmesa6), or render on a machine with a display"
)


def choose() -> None:
    """Choose a backend for offscreen rendering in this process; call it before MuJoCo is imported.

    The backend set in ``MUJOCO_GL`` is kept if it works.

    Raises:
        RequestError: No backend works on this machine.
    """
    asked = os.environ.get("MUJOCO_GL", "").lower()
    for backend in (asked,) if asked else BACKENDS:
        if draws(backend):
            os.environ["MUJOCO_GL"] = backend
            return
    raise RequestError(_MISSING.format(repr(asked) if asked else ", ".join(BACKENDS)))


def draws(backend: str) -> bool:
    """Return whether MuJoCo can render with a backend on this machine."""
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
