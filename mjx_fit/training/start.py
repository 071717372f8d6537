"""Initial weights of a training run: new, or from a trained sensor (``--init``)."""

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from mjx_fit.config.schema import Config, config_differences
from mjx_fit.data.episode import Episode
from mjx_fit.sensors.contact_sensor import ContactSensor, InputScale
from mjx_fit.training import checkpoint, compatibility
from mjx_fit.training.step import TrainState
from mjx_fit.types import Array
from mjx_fit.utils.errors import RequestError

_FREE = ("dropout",)
"""Keys of the network that may differ, because they change no weights."""


class Start(NamedTuple):
    """Trained sensor that provides the initial weights of another training.

    Attributes:
        sensor: The sensor with its input normalisation.
        origin: JSON-ready record of the sensor for ``run.json``: its fingerprint and its training data.
    """

    sensor: ContactSensor
    origin: dict[str, Any]

    def weights(self) -> tuple[nnx.State, nnx.State]:
        """Return the parameters and the input normalisation, as in ``TrainState``."""
        _, params, scale = nnx.split(self.sensor, nnx.Param, InputScale)
        return params, scale


def read(init: Path | None, config: Config, members: int, inside: str) -> list[Start | None]:
    """Load the initial sensor of each member of an ensemble, or of a single sensor.

    If the other run is an ensemble, each member starts from the best checkpoint of the same member; otherwise
    all start from the same sensor, each with its own windows and noise. The baseline starts from the baseline
    of the other run, if any. Without a sensor to start from, or without ``init``, the weights are new.

    Args:
        init: Folder of the other run, or None.
        config: Configuration of the new run; its network and shapes must equal those of the other run, and
            its coordinates begin with those.
        members: Number of members of the new run.
        inside: Subfolder of the run folder for this training.

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
    """Check that no initial sensor was trained on the validation data of this run.

    Args:
        starts: Initial sensors.
        data: Stacked episodes.
        data_id: Fingerprint of the data.
        config: Configuration, with ``train.validation_fraction`` in use.
        seed: Root seed.

    Raises:
        RequestError: A sensor was trained at the same holes with another train/validation split.
    """
    here = {"data": data_id, "seed": seed, "validation_fraction": config.train.validation_fraction}
    for start in starts:
        for told in compatibility.lineage(start.origin) if start else ():
            if compatibility.shares_holes(told, data, data_id) and any(
                told.get(key) != here[key] for key in here
            ):
                raise RequestError(
                    "--init: a sensor that was trained at holes of these --data cannot be used: it has seen "
                    "what it would be validated on; use the same data, --seed and train.validation_fraction "
                    f"({told.get('seed')} and {told.get('validation_fraction')} there), or collect with "
                    "another --seed"
                )


def begin(start: Start | None, state: TrainState) -> TrainState:
    """Return the initial training state, with the weights of the trained sensor, if any.

    A sensor of fewer coordinates keeps what it says of them; heads of the others are new.
    """
    if start is None:
        return state
    params, scale = start.weights()
    fewer, more = start.sensor.position_noise.d, state.params["position"]["last"]["bias"].shape[-1]
    grown = jax.tree.map(lambda old, new: _grown(old, new, fewer, more), params, state.params)
    return replace(state, params=grown, scale=scale)


def _grown(old: Array, new: Array, fewer: int, more: int) -> Array:
    """Return the weights of a head of more coordinates, with those of a trained one of its first ones.

    The last axis of ``sensors.heads.PositionNoise`` has a triangle's diagonal first, then the rows below.
    """
    if old.shape == new.shape:
        return old
    below = fewer * (fewer - 1) // 2
    columns = np.arange(fewer)
    if old.shape[-1] != fewer:
        columns = np.concatenate([columns, more + np.arange(below)])
    return jnp.asarray(new).at[..., columns].set(old)


def origins(starts: list[Start | None]) -> list[dict[str, Any] | None]:
    """Return the record of each member's initial sensor."""
    return [start.origin if start else None for start in starts]


def _start(run: Path, inside: str, config: Config) -> Start | None:
    if inside and run.is_dir() and not (run / inside).is_dir():
        return None
    run = run / inside
    try:
        sensor, there = checkpoint.load_sensor(run)
    except RequestError as error:
        raise RequestError(str(error).replace("--run:", "--init:", 1)) from None
    told, wanted = there.filter.coordinates, config.filter.coordinates
    if told != wanted[: len(told)]:
        raise RequestError(
            f"--init: {run} cannot be used: filter.coordinates is [{', '.join(told)}] there and "
            f"[{', '.join(wanted)}] here: expected its coordinates first"
        )
    others = config_differences(there, config, _belongs_to_sensor)
    if others:
        raise RequestError(
            f"--init: {run} cannot be used: {others[0]}; use the --config and --set of its training"
        )
    told = {
        "sensor": checkpoint.fingerprint_of(sensor),
        "validation_fraction": there.train.validation_fraction,
    }
    return Start(sensor, told | compatibility.told_by(run))


def _belongs_to_sensor(section: str, key: str) -> bool:
    """Return True for a key that decides the weights' shapes or their meaning."""
    return (section == "sensor" and key not in _FREE) or (section, key) == ("scene", "shapes")
