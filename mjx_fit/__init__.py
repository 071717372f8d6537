"""Contact-rich assembly under uncertainty, on JAX and MuJoCo."""


def __getattr__(name: str) -> str:
    """``__version__``, looked up when it is asked for: a command takes Ctrl-C before it imports anything."""
    if name == "__version__":
        from importlib.metadata import version

        return version("mjx-fit")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
