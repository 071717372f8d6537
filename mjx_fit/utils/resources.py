"""Location of files shipped with the package: ``assets/``, or, in a checkout, partly the repository root."""

from pathlib import Path

_PACKAGE = Path(__file__).parents[1]


def folder(name: str) -> Path:
    """Return the folder ``models``, ``configs`` or ``weights``; the last is a training run."""
    packaged = _PACKAGE / "assets" / name
    return packaged if packaged.is_dir() else _PACKAGE.parent / name
