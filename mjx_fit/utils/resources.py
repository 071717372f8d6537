"""Where the files that ship with the package lie: in ``assets/``, or, of a checkout, partly at its top."""

from pathlib import Path

_PACKAGE = Path(__file__).parents[1]


def folder(name: str) -> Path:
    """The folder ``models``, ``configs`` or ``weights``; the last is a training run."""
    packaged = _PACKAGE / "assets" / name
    return packaged if packaged.is_dir() else _PACKAGE.parent / name
