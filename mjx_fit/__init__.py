"""Contact-rich assembly under uncertainty, on JAX and MuJoCo."""

from importlib.metadata import version

__version__ = version("mjx-fit")
