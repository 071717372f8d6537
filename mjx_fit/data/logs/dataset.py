"""Write the attempts of logs as a data set, with the truth that their map says, or with none."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from mjx_fit.config.schema import Config, config_to_tree
from mjx_fit.data.episode import Episode, unknown_truth
from mjx_fit.data.hdf5 import encode
from mjx_fit.data.logs.importing import ImportedLog, LoggedAttempt
from mjx_fit.data.manifest import ROBOT
from mjx_fit.data.schedule import stored_policies
from mjx_fit.data.writer import Writer, new_manifest, new_shard
from mjx_fit.filters.updates import detected_belief
from mjx_fit.task.logged_attempt import padded
from mjx_fit.types import Felt, Rollout, Truth
from mjx_fit.utils import files
from mjx_fit.utils.errors import RequestError

SHARD = 250
"""Most attempts in one file."""


def write_logs(logs: Sequence[ImportedLog], paths: Sequence[Path], config: Config, out: Path) -> int:
    """Write a data set with an episode for each attempt, in the order of the logs, and return their number.

    Args:
        logs: The logs.
        paths: Their files or folders, which are stored by name and digest.
        config: Configuration with which they were read.
        out: Folder of the data set; the same logs resume it.

    Raises:
        RequestError: A log was refused, a pose at rest is missing, or the folder holds another data set.
    """
    refused = [log for log in logs if log.refused]
    if refused:
        lines = "; ".join(str(one) for one in refused[0].findings if one.severity == "refused")
        raise RequestError(f"{refused[0].name}: {lines}")
    attempts = [(log.name, one) for log in logs for one in log.attempts]
    for name, one in attempts:
        if one.felt.start is None:
            raise RequestError(f"{name}: no pose before the attempt at {one.begin_s:.3f} s: it is needed")
    steps = max(int(one.felt.length) for _, one in attempts)
    labelled = all(one.truth is not None for _, one in attempts)
    request = {
        "episodes": len(attempts),
        "steps": steps,
        "policy": ROBOT,
        "seed": 0,
        "batch": SHARD,
        "sequence": 1,
        **({"labelled": True} if labelled else {}),
        "logs": [_told(log, path) for log, path in zip(logs, paths, strict=True)],
        "engine": ROBOT,
        "config": config_to_tree(config),
    }
    first = {f"shard-{k:08d}.h5": k for k in range(0, len(attempts), SHARD)}
    with Writer(out, new_manifest(request, (0, 1))) as writer:
        for name in writer.missing(first):
            own = [one for _, one in attempts[first[name] : first[name] + SHARD]]
            content = encode(_episodes(own, first[name], steps, config), request)
            writer.write(new_shard(name, first[name] + np.arange(len(own)), content), content)
        writer.finish()
    return len(attempts)


def _told(log: ImportedLog, path: Path) -> dict[str, object]:
    spans = [[one.begin_s, one.end_s] for one in log.attempts]
    if not path.is_dir():
        return {"name": log.name, "sha256": files.sha256(path), "attempts": spans}
    digests = "".join(files.sha256(one) for one in sorted(path.iterdir()) if one.is_file())
    return {"name": log.name, "sha256": files.sha256_of(digests.encode()), "attempts": spans}


def _episodes(attempts: list[LoggedAttempt], first: int, steps: int, config: Config) -> Episode:
    felt = [padded(one.felt, steps) for one in attempts]
    stacked: Felt = jax.tree.map(lambda *leaves: np.stack(leaves), *felt)
    ids, n = first + np.arange(len(felt)), len(felt)
    said = np.asarray(stacked.estimate_world)
    estimate = np.pad(said, ((0, 0), (0, len(config.filter.coordinates) - said.shape[1])))
    belief = detected_belief(jnp.asarray(estimate), config)
    return Episode(
        episode=ids,
        sequence=ids,
        number=np.zeros(n, int),
        policy=np.full(n, stored_policies(ROBOT).index(ROBOT), np.int32),
        estimate_cov=np.asarray(belief.cov, np.float32),
        rollout=Rollout(replace(stacked, estimate_world=estimate), _truth(attempts, config)),
    )


def _truth(attempts: list[LoggedAttempt], config: Config) -> Truth:
    unknown = unknown_truth(len(attempts), config)
    told = [one.truth for one in attempts if one.truth is not None]
    if len(told) < len(attempts):
        return unknown
    return replace(
        unknown,
        hole_type=np.array([one.hole_type for one in told], np.int32),
        hole_pos_world=np.array([one.place_world for one in told], np.float32),
        inserted=np.array([one.inserted for one in told]),
    )
