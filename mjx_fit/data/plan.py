"""Plan of a data set: what to collect."""

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from mjx_fit.config.schema import Config, config_to_tree
from mjx_fit.config.sections.first import FIRST_VALUES
from mjx_fit.config.sections.learning import SensorConfig, TrainConfig
from mjx_fit.data.manifest import Manifest
from mjx_fit.data.manifest_schema import MAX_ACTIONS, MAX_BATCH, MAX_EPISODES, MAX_SEQUENCE
from mjx_fit.data.schedule import POLICIES
from mjx_fit.engines.interface import Engine, stored_policy_name
from mjx_fit.engines.select import resolve
from mjx_fit.engines.threads import even_batch
from mjx_fit.utils.errors import RequestError, require, shown
from mjx_fit.utils.randomness import require_seed

STORED_ACTIONS = "steps"
"""Key of ``Plan.actions`` in stored requests, kept from the first version."""


@dataclass(frozen=True)
class Plan:
    """Plan of a data set.

    Example:
        >>> import mjx_fit as mf
        >>> mf.CollectionPlan(episodes=600, sequence=3).sequences
        200

    Attributes:
        episodes: Number of rollouts, a multiple of ``sequence``.
        actions: Most actions in one rollout. A spiral lasts ``task.attempt_actions`` unless this is less.
        policy: ``spiral``, ``random``, or ``mixed``: both in turn; or the name of the engine's custom policy.
        engine: ``auto``, ``mjx`` or ``native``.
        seed: Root seed.
        batch: Most rollouts in one shard; their sequences are simulated together.
        sequence: Consecutive attempts of one peg at one hole. The first starts from the detector's estimate,
            later ones from estimates that resemble a filter's. Attempts after an insertion are not
            performed.
        shard_index: Part of the data set to collect, from 0.
        num_shards: Number of parts.
        sensor: Fingerprint of the sensor whose posteriors the later attempts start from; empty: sampled
            estimates.
        turns: Whether commands turn the TCP. ``collect`` asks the engine.
    """

    episodes: int = 3000
    actions: int = 100
    policy: str = "spiral"
    engine: str = "auto"
    seed: int = 0
    batch: int = 250
    sequence: int = 1
    shard_index: int = 0
    num_shards: int = 1
    sensor: str = ""
    turns: bool = False

    @property
    def sequences(self) -> int:
        return self.episodes // self.sequence

    @property
    def worlds(self) -> int:
        """Number of worlds in each batch, one per sequence; the last batch may have idle worlds."""
        return even_batch(self.sequences, max(1, self.batch // self.sequence))

    def shards(self) -> dict[str, int]:
        """Return the shards of this part: the first sequence of each, by file name."""
        starts = range(0, self.sequences, self.worlds)[self.shard_index :: self.num_shards]
        return {f"shard-{start * self.sequence:08d}.h5": start for start in starts}

    def command(self, out: Path) -> str:
        """Return the command that collects this, without its configuration."""
        options = [
            f"--{field.name.replace('_', '-')} {getattr(self, field.name)}"
            for field in fields(self)
            if field.name not in ("sensor", "turns")
        ]
        if self.sensor:
            options.append(f"--run RUN, the one whose sensor is {self.sensor},")
        return f"mjx-fit collect --out {out} " + " ".join(options)

    def request(self, config: Config) -> dict[str, Any]:
        """Return the identity of the data set, JSON-ready and equal in all parts.

        Episodes depend on the sensor itself, which ``sensor`` identifies, but not on the sections ``sensor``
        and ``train``. Those are stored with fixed values, because bytes and digests depend on them.
        """
        return {
            "episodes": self.episodes,
            STORED_ACTIONS: self.actions,
            **{name: getattr(self, name) for name in ("policy", "seed", "batch", "sequence")},
            **({"sensor": self.sensor} if self.sensor else {}),
            **({"turns": True} if self.turns else {}),
            "engine": resolve(self.engine),
            "config": config_to_tree(
                replace(
                    config,
                    sensor=SensorConfig(**FIRST_VALUES["sensor"]),
                    train=TrainConfig(**FIRST_VALUES["train"]),
                )
            ),
        }


def plan_of(manifest: Manifest) -> Plan:
    """Return the plan of a data set."""
    index, of = manifest.part
    asked = {name: value for name, value in manifest.request.items() if name != "config"}
    return Plan(actions=asked.pop(STORED_ACTIONS), **asked, shard_index=index, num_shards=of)


def check(plan: Plan) -> None:
    """Check the numbers of a plan.

    Raises:
        RequestError: One is out of range.
    """
    require_seed(plan.seed)
    require("--episodes", plan.episodes, 1, MAX_EPISODES)
    require("--actions", plan.actions, 1, MAX_ACTIONS)
    require("--batch", plan.batch, 1, MAX_BATCH)
    require("--sequence", plan.sequence, 1, MAX_SEQUENCE)
    require("--num-shards", plan.num_shards, 1, MAX_EPISODES)
    require("--shard-index", plan.shard_index, 0, plan.num_shards - 1, "one less than --num-shards")
    if plan.episodes % plan.sequence:
        raise RequestError(
            f"--episodes: {plan.episodes} is invalid: expected a multiple of --sequence, {plan.sequence}"
        )
    if plan.sensor and plan.sequence == 1:
        raise RequestError("--run cannot be used with --sequence 1: only later attempts start from beliefs")
    batches = -(-plan.sequences // plan.worlds)
    if plan.num_shards > batches:
        raise RequestError(
            f"--num-shards: {plan.num_shards} is invalid: expected at most {batches}, the number of "
            "batches; a smaller --batch makes more"
        )


def require_engine(plan: Plan, engine: Engine) -> None:
    """Check that the engine and its policy are those of the plan, so that no data get another's name.

    Raises:
        RequestError: They differ, or there is no such policy.
    """
    name, own = plan.policy, stored_policy_name(engine)
    if resolve(plan.engine) != engine.name:
        raise RequestError(f"--engine: {plan.engine} does not match the engine {engine.name}")
    if own is None and name not in POLICIES:
        raise RequestError(f"--policy: {shown(name)} is invalid: expected one of {', '.join(POLICIES)}")
    if own is not None and (name != own or own in POLICIES):
        raise RequestError(f"--policy: {shown(name)} does not match the engine's custom policy, {shown(own)}")
