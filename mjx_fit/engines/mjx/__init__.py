"""Scenes in motion: the engines."""

import io
from contextlib import redirect_stdout

with redirect_stdout(io.StringIO()):  # MJX prints that Warp is missing, which would spoil --json
    import mujoco.mjx  # noqa: F401
