"""MJX engine: batched physics in JAX."""

import io
from contextlib import redirect_stdout

with redirect_stdout(io.StringIO()):  # MJX prints that Warp is missing, which would corrupt --json
    import mujoco.mjx  # noqa: F401
