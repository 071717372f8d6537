"""Metrics of a training run as it goes on: ``metrics.jsonl``, and event files for TensorBoard."""

from pathlib import Path
from typing import Any

from mjx_fit.training import run_files
from mjx_fit.utils.errors import RequestError


class Journal:
    """Files with the metrics of each member's epochs.

    Args:
        folders: Folder of each member.
        epochs_done: Number of epochs that are stored; what the files say about later ones is dropped.
        tensorboard: Whether to write event files as well.

    Raises:
        RequestError: tensorboardX is not installed.
    """

    def __init__(self, folders: list[Path], epochs_done: int, *, tensorboard: bool):
        self._folders, self._writers = folders, []
        for folder in folders:
            run_files.keep_metrics(folder, epochs_done)
        if tensorboard:
            # Files are named by the second, in which a run may end and go on.
            suffix = f".{epochs_done}"
            self._writers = [
                _writer()(str(folder), purge_step=epochs_done, filename_suffix=suffix) for folder in folders
            ]

    def append(self, rows: list[dict[str, Any]]) -> None:
        """Write the metrics of an epoch of each member; charts are ``training/NAME``, ``validation/NAME``."""
        for folder, row in zip(self._folders, rows, strict=True):
            run_files.append_metrics(folder, row)
        for writer, row in zip(self._writers, rows, strict=False):
            for name, value in row.items():
                if name != "epoch":
                    # The prior is that of the validation windows.
                    validates = name.startswith("val_") or name == "prior_nll"
                    chart = f"{'validation' if validates else 'training'}/{name.removeprefix('val_')}"
                    writer.add_scalar(chart, value, row["epoch"])
            writer.flush()

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *_) -> None:
        for writer in self._writers:
            writer.close()


def require_tensorboard() -> None:
    """Check that event files can be written.

    Raises:
        RequestError: tensorboardX is not installed.
    """
    _writer()


def _writer():
    try:
        from tensorboardX import SummaryWriter
    except ImportError:
        raise RequestError(
            "--tensorboard needs tensorboardX, which is not installed: pip install 'mjx-fit[tensorboard]'"
        ) from None
    return SummaryWriter
