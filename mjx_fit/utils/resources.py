"""Location of files shipped with the package: ``assets/``, or, in a checkout, partly the repository root."""

from pathlib import Path

_PACKAGE = Path(__file__).parents[1]
SHIPPED_RUNS = {"as-2026-11": "weights-as-2026-11", "gentle": "weights-gentle", "nist": "weights-nist"}
"""Folder of each training run that ships under a name."""


def folder(name: str) -> Path:
    """Return a folder that ships: ``models``, ``configs``, or a training run such as ``weights``."""
    packaged = _PACKAGE / "assets" / name
    return packaged if packaged.is_dir() else _PACKAGE.parent / name


def run_folder(run: Path | str | None) -> Path:
    """Return the folder of a training run.

    Args:
        run: Folder, or the name of weights that ship with the package, where no folder has that name; None:
            the weights that ship as the default.
    """
    if run is None:
        return folder("weights")
    shipped = SHIPPED_RUNS.get(str(run))
    return folder(shipped) if shipped and not Path(run).exists() else Path(run)
