"""Where a training starts: from new weights, or from those of a trained sensor (``--init``)."""

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from flax import nnx

from mjx_fit.config.schema import Config, config_differences
from mjx_fit.data.episode import Episode
from mjx_fit.sensors.contact_sensor import ContactSensor, InputScale
from mjx_fit.training import checkpoint, compatibility
from mjx_fit.training.step import TrainState
from mjx_fit.utils.errors import RequestError

_FREE = ("sensor.dropout",)
"""Of the network's settings: changes no weight."""


class Start(NamedTuple):
    """A trained sensor that another training starts from.

    Attributes:
        sensor: It, with its input scaling.
        origin: What a run remembers of it, JSON-ready: its fingerprint, and what it was trained on.
    """

    sensor: ContactSensor
    origin: dict[str, Any]

    def weights(self) -> tuple[nnx.State, nnx.State]:
        """Parameters and input scaling, as in ``TrainState``."""
        _, params, scale = nnx.split(self.sensor, nnx.Param, InputScale)
        return params, scale


def read(init: Path | None, config: Config, members: int, inside: str) -> list[Start | None]:
    """What each member of an ensemble starts from, or the one sensor that is trained.

    From the best checkpoint of the same member where the other run is an ensemble, too, and else all from the
    same one, each with its own windows and noise. The baseline starts from the other's; where that has none,
    from new weights, as everything does without ``init``.

    Args:
        init: Folder of the other run, or None.
        config: Of the new run: its network and shapes must be the other's.
        members: Of the new run.
        inside: Folder inside that of the run where the training is.

    Raises:
        RequestError: The other run cannot be used.
    """
    if init is None:
        return [None] * members
    if not (init / "member-0").is_dir():
        return [_start(init, inside, config)] * members
    there = len(list(init.glob("member-*")))
    if members == 1:
        raise RequestError(
            f"--init: {init} cannot be used: it holds {there} sensors; name one, e.g. {init / 'member-0'}"
        )
    if members > there:
        raise RequestError(f"--members: {members} cannot be used: --init {init} holds {there} sensors")
    return [_start(init / f"member-{member}", inside, config) for member in range(members)]


def require_unseen(
    starts: list[Start | None], data: Episode, data_id: str, config: Config, seed: int
) -> None:
    """Make sure that no sensor starts that has seen what it is to be validated on.

    Args:
        starts: Where the training starts.
        data: Stacked episodes.
        data_id: Their fingerprint.
        config: ``train.validation_fraction`` is used.
        seed: Root seed.

    Raises:
        RequestError: One was trained at the same holes, divided in another way.
    """
    here = {"data": data_id, "seed": seed, "validation_fraction": config.train.validation_fraction}
    for start in starts:
        for told in compatibility.lineage(start.origin) if start else ():
            if compatibility.shares_holes(told, data, data_id) and any(
                told.get(key) != here[key] for key in here
            ):
                raise RequestError(
                    "--init: a sensor that was trained at holes of these --data cannot be used, unless with "
                    "the very same data, --seed and train.validation_fraction "
                    f"({told.get('seed')} and {told.get('validation_fraction')} there): it has seen what it "
                    "would be validated on; collect with another --seed"
                )


def begin(start: Start | None, state: TrainState) -> TrainState:
    """The state that training starts in: new weights' state, with the trained sensor's weights, if any."""
    if start is None:
        return state
    params, scale = start.weights()
    return replace(state, params=params, scale=scale)


def origins(starts: list[Start | None]) -> list[dict[str, Any] | None]:
    """What the run of each member remembers."""
    return [start.origin if start else None for start in starts]


def _start(run: Path, inside: str, config: Config) -> Start | None:
    if inside and run.is_dir() and not (run / inside).is_dir():
        return None
    run = run / inside
    try:
        sensor, there = checkpoint.load_sensor(run)
    except RequestError as error:
        raise RequestError(str(error).replace("--run:", "--init:", 1)) from None
    others = [
        words
        for words in config_differences(there, config)
        if words.startswith(("sensor.", "scene.shapes ")) and not words.startswith(_FREE)
    ]
    if others:
        raise RequestError(
            f"--init: {run} cannot be used: {others[0]}; give the --config and --set that it was trained with"
        )
    told = {
        "sensor": checkpoint.fingerprint_of(sensor),
        "validation_fraction": there.train.validation_fraction,
    }
    return Start(sensor, told | compatibility.told_by(run))
