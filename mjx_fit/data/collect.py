"""Collect rollouts into a data set."""

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mjx_fit.config import cross_section_rules, randomized
from mjx_fit.config.schema import Config, require_room
from mjx_fit.data import hdf5
from mjx_fit.data.plan import Plan, check, require_engine
from mjx_fit.data.sequences import Sequences
from mjx_fit.data.writer import NewShard, Writer, is_finished, new_manifest, new_shard
from mjx_fit.engines.failures import kept_in
from mjx_fit.engines.interface import Engine
from mjx_fit.jobs.pool import Here, Pool, Tell
from mjx_fit.task.estimator import Update
from mjx_fit.utils import memory
from mjx_fit.utils.filesystem import path_inside
from mjx_fit.utils.progress import COMPILING, Progress
from mjx_fit.utils.rates import ACTION_BYTES, SUBSTEPS

_BROKEN = "broken"
"""Subfolder of the data set for replay files of diverged simulations."""


def collect(
    config: Config,
    out: Path,
    plan: Plan,
    engine: Engine,
    update: Update | None = None,
    pool: Pool | None = None,
) -> None:
    """Simulate interactions and store them; resume an interrupted collection with the same request.

    The draws of an episode depend on the seed and its id alone. All batches have the same shape, the last one
    padded, since arithmetic on other shapes may differ in the last bit.

    Args:
        config: The configuration.
        out: Folder of the data set.
        plan: Collection plan.
        engine: Engine that simulates the attempts; it must be the one named in the plan.
        update: Belief update with the sensor of fingerprint ``plan.sensor``.
        pool: Simulates the shards; None: this process.

    Raises:
        RequestError: A value is invalid, or the folder holds other files or is in use.
        WorkError: As in ``Pool.run``.
    """
    check(plan)
    plan = replace(plan, turns=engine.turns)
    if plan.policy in ("random", "mixed"):
        require_room(config, "random.reach_m", config.random.reach_m)
        for corner in randomized.extremes(config):
            cross_section_rules.require_random_upright(corner.scene, corner.control, corner.random)
    _require_memory(config, plan)
    require_engine(plan, engine)
    request, shards = plan.request(config), plan.shards()
    wanted = new_manifest(request, (plan.shard_index, plan.num_shards))
    if is_finished(out, wanted, shards):
        return
    with Writer(out, wanted) as writer:
        missing = writer.missing(shards)
        if missing:
            simulate = Sequences(engine, config, plan, path_inside(out.absolute(), _BROKEN), update)
            work = partial(_collected, simulate, request)
            begins = COMPILING if engine.name == "mjx" else ""
            with Progress("collect: shard", len(shards), len(shards) - len(missing), begins) as progress:
                pieces = {name: (name, shards[name]) for name in missing}
                _fill(writer, pieces, work, pool or Here(), progress)
        writer.finish()


def _require_memory(config: Config, plan: Plan) -> None:
    """Refuse a batch whose rollouts, plus those of one attempt, exceed the available memory."""
    rows = plan.sequence * plan.actions + min(plan.actions, config.task.attempt_actions)
    what = f"--batch: {plan.batch} with up to {plan.actions} actions"
    memory.require(plan.worlds * rows * ACTION_BYTES, what, "lower it")


def invalid_in(out: Path) -> str:
    """Describe how many interactions of a collection are invalid; empty if all are valid."""
    count = kept_in(out / _BROKEN)
    return f", {count} invalid (excluded from training)" if count else ""


def _fill(
    writer: Writer,
    missing: dict[str, tuple[str, int]],
    work: Callable[[tuple[str, int], Tell], NewShard],
    pool: Pool,
    progress: Progress,
) -> None:
    """Collect the missing shards, whoever simulates them."""
    began, sums = time.monotonic(), Counter[str]()

    def told(_: int, text: str) -> None:
        progress(progress.done + sums["shards"], text)

    for _, one in pool.run(work, missing, told, writer.storing(here=pool.alone)):
        writer.add(one.shard)
        sums.update(one.counts, shards=1)
        speed = sums["actions"] * SUBSTEPS / (time.monotonic() - began)
        words = [f"{sums['inserted']} inserted", f"{speed:,.0f} steps/s"]
        if sums["inserted_wrongly"]:
            words.insert(1, f"{sums['inserted_wrongly']} inserted wrongly")
        if sums["invalid"]:
            words.append(f"{sums['invalid']} invalid")
        told(0, ", ".join(words))


def _collected(simulate: Sequences, request: dict[str, Any], piece: tuple[str, int], _: Tell) -> NewShard:
    """Simulate the shard of a name and a first sequence."""
    name, start = piece
    episodes = simulate(start)
    rollout = episodes.rollout
    counts = {
        "actions": int(rollout.felt.length.sum()),
        "inserted": int(rollout.succeeded.sum()),
        "inserted_wrongly": int(rollout.inserted_wrongly.sum()),
        "invalid": int((~rollout.truth.valid).sum()),
    }
    content = hdf5.encode(episodes, request)
    return NewShard(new_shard(name, np.asarray(episodes.episode), content), content, counts)
