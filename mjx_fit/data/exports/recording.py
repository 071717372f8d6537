"""Attempts of a data set as a robot would have recorded them."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from mjx_fit.config.schema import config_from_stored
from mjx_fit.data.episode import UNKNOWN, Episode, happened
from mjx_fit.data.manifest import Manifest, knows_truth
from mjx_fit.data.reader import read_shards
from mjx_fit.scene.placement import place_for_tool
from mjx_fit.sensors.resampling import log_from_felt
from mjx_fit.sensors.sensor_log import SensorLog
from mjx_fit.types import Felt, Truth


class Recording(NamedTuple):
    """One attempt.

    Attributes:
        episode: Id of the episode.
        log: Its samples; the first action begins at 0 s, and the first pose is that at rest.
        turn_world: Commanded rotation of the TCP in each action (J, 3), rad; None: the robot only moves.
        peg: Name of the peg's type.
        estimate: Where the hole was believed to be (D,), m and rad.
        truth: What happened; None: nobody knows.
        hole: Name of the hole's type; None: nobody knows.
        place_world: Where the TCP is when the peg is in the hole, x and y, m; None: nobody knows.
    """

    episode: int
    log: SensorLog
    turn_world: Float[np.ndarray, "J 3"] | None
    peg: str
    estimate: Float[np.ndarray, "D"]
    truth: Truth | None
    hole: str | None
    place_world: Float[np.ndarray, "2"] | None


def recordings(folder: Path, manifest: Manifest) -> Iterator[list[Recording]]:
    """Yield the attempts of each shard of a data set that were performed and did not diverge."""
    config = config_from_stored(manifest.request["config"])
    for shard in read_shards(folder, manifest.shards, manifest.request):
        found, truth = [], shard.rollout.truth
        places = np.asarray(place_for_tool(truth.hole_pos_world, truth.physics, config))[:, :2]
        for row in np.flatnonzero(happened(shard)):
            episode: Episode = jax.tree.map(lambda leaf, row=row: np.asarray(leaf[row]), shard)
            felt: Felt = episode.rollout.felt
            turns = felt.trace.turn_world
            truth = None if episode.rollout.truth.hole_type == UNKNOWN else episode.rollout.truth
            found.append(
                Recording(
                    episode=int(episode.episode),
                    log=log_from_felt(felt, config=config),
                    turn_world=None if turns is None else np.asarray(turns)[: int(felt.length)],
                    peg=config.scene.names[int(felt.peg_type)],
                    estimate=np.asarray(felt.estimate_world),
                    truth=truth,
                    hole=None if truth is None else config.scene.names[int(truth.hole_type)],
                    place_world=None if truth is None else places[row],
                )
            )
        yield found


def truth_of(manifest: Manifest, hole: str, place: str, inserted: str) -> dict[str, Any]:
    """Return the section ``truth`` of an export's map with these sources; none where it would be refused."""
    planar = len(config_from_stored(manifest.request["config"]).filter.coordinates) == 2
    if not (knows_truth(manifest.request) and planar):
        return {}
    return {"truth": {"hole_source": hole, "place_source": place, "inserted_source": inserted}}
