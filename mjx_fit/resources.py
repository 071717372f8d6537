"""Where the files that belong to the package lie: inside it, or, of a checkout, at its top."""

from pathlib import Path

_PACKAGE = Path(__file__).parent


def folder(name: str) -> Path:
    """The folder ``models``, ``configs`` or ``weights``; the last is a training run."""
    packaged = _PACKAGE / name
    return packaged if packaged.is_dir() else _PACKAGE.parent / name
