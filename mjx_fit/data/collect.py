"""Collect rollouts into a data set."""

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mjx_fit.config import cross_section_rules, randomized
from mjx_fit.config.schema import Config, require_room
from mjx_fit.data import hdf5
from mjx_fit.data.plan import Plan, check, require_engine
from mjx_fit.data.sequences import Sequences
from mjx_fit.data.writer import Writer, is_finished, new_manifest, new_shard
from mjx_fit.engines.failures import kept_in
from mjx_fit.engines.interface import Engine
from mjx_fit.task.estimator import Update
from mjx_fit.utils import memory
from mjx_fit.utils.filesystem import path_inside
from mjx_fit.utils.progress import COMPILING, Progress
from mjx_fit.utils.rates import ACTION_BYTES, SUBSTEPS

_BROKEN = "broken"
"""Subfolder of the data set for replay files of diverged simulations."""


def collect(config: Config, out: Path, plan: Plan, engine: Engine, update: Update | None = None) -> None:
    """Simulate interactions and store them; resume an interrupted collection with the same request.

    The draws of an episode depend on the seed and its id alone. All batches have the same shape, the last one
    padded, since arithmetic on other shapes may differ in the last bit.

    Args:
        config: The configuration.
        out: Folder of the data set.
        plan: Collection plan.
        engine: Engine that simulates the attempts; it must be the one named in the plan.
        update: Belief update with the sensor of fingerprint ``plan.sensor``.

    Raises:
        RequestError: A value is invalid, or the folder holds other files or is in use.
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
            simulate = Sequences(engine, config, plan, path_inside(out, _BROKEN), update)
            _fill(writer, {name: shards[name] for name in missing}, len(shards), simulate, request)
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
    writer: Writer, missing: dict[str, int], n_shards: int, simulate: Sequences, request: dict[str, Any]
) -> None:
    began, actions, inserted, wrongly = time.monotonic(), 0, 0, 0
    done = n_shards - len(missing)
    begins = COMPILING if request["engine"] == "mjx" else ""
    with Progress("collect: shard", n_shards, done, begins) as progress:
        for name, start in missing.items():
            episodes = simulate(start)
            content = hdf5.encode(episodes, request)
            writer.write(new_shard(name, np.asarray(episodes.episode), content), content)
            done += 1
            actions += int(episodes.rollout.felt.length.sum())
            inserted += int(episodes.rollout.succeeded.sum())
            wrongly += int(episodes.rollout.inserted_wrongly.sum())
            speed = actions * SUBSTEPS / (time.monotonic() - began)
            words = [f"{inserted} inserted", f"{speed:,.0f} steps/s"]
            if wrongly:
                words.insert(1, f"{wrongly} inserted wrongly")
            if simulate.broken:
                words.append(f"{simulate.broken} invalid")
            progress(done, ", ".join(words))
