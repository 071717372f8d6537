"""Members of an ensemble, each trained by a worker of a pool."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from mjx_fit.config.schema import Config
from mjx_fit.jobs.pool import Pool, Tell
from mjx_fit.training.run import Run
from mjx_fit.training.train import train_from
from mjx_fit.utils.progress import Progress


def train_members(folders: Sequence[Path], config: Config, run: Run, pool: Pool) -> bool:
    """Train the members of an ensemble apart, or resume them; each is the sensor that it is among the others.

    Weights, windows and noise of a member are its own, so that members differ from those that train at once
    (``mjx_fit.training.loop.train``) by rounding, and by where early stopping ends each.

    Args:
        folders: Folders of the data sets, which every worker can read.
        config: Full configuration.
        run: Output folder, which every worker can write to, seed, number of sensors and initial weights.
        pool: Trains the members.

    Returns:
        False if all were already complete.

    Raises:
        RequestError: As in ``train_from``.
        WorkError: As in ``Pool.run``.
    """
    alone = replace(run, out=run.out.absolute(), init=run.init.absolute() if run.init else None)
    work = partial(_trained, [folder.absolute() for folder in folders], config, alone)
    outs = [folder.absolute() for folder in run.folders()]
    pieces = {f"member {m}": (m, out) for m, out in enumerate(outs)}
    trained = False
    with Progress("train: members", len(pieces)) as progress:
        for done, (_, was_left) in enumerate(pool.run(work, pieces, lambda _, text: progress(0, text)), 1):
            trained |= was_left
            progress(done)
    return trained


def _trained(folders: Sequence[Path], config: Config, run: Run, piece: tuple[int, Path], _: Tell) -> bool:
    """Train the member of a number in its folder."""
    member, out = piece
    init = run.init
    if init is not None and (init / f"member-{member}").is_dir():
        init = init / f"member-{member}"
    return train_from(folders, config, replace(run, out=out, members=1, member=member, init=init))
