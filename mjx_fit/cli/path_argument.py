"""Parse paths with ``~``."""

import argparse
from pathlib import Path

from mjx_fit.utils import resources


def path(text: str) -> Path:
    """Return an option's path with ``~`` and ``~user`` expanded, which shells do not do after ``--out=``.

    Raises:
        argparse.ArgumentTypeError: The text is not a valid path.
    """
    if not text.strip():
        raise argparse.ArgumentTypeError(f"{text!r} is invalid: it must name a file or a folder")
    if "\0" in text:
        raise argparse.ArgumentTypeError(f"{text!r} cannot be used: a path holds no NUL")
    try:
        text.encode()
    except UnicodeEncodeError:
        raise argparse.ArgumentTypeError(f"{text!a} is invalid: expected valid UTF-8") from None
    try:
        return Path(text).expanduser()
    except RuntimeError:
        user = Path(text).parts[0]
        raise argparse.ArgumentTypeError(
            f"{text!r} cannot be used: no home folder of {user} is known; write ./{user} for a folder "
            "of that name"
        ) from None


def run_path(text: str) -> Path:
    """Return the folder of a training run: a path as from ``path``, or the name of weights that ship.

    Raises:
        argparse.ArgumentTypeError: As from ``path``.
    """
    return resources.run_folder(path(text))
