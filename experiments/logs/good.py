"""How often are good logs refused? Attempts of three worlds, alone and three at a time.

    python experiments/logs/good.py OUT.json [--attempts N] [--seed K]

Shares of logs that the laws of contact (``mjx_fit.data.logs.consistency``) refuse, and that they remark on.
The thresholds were chosen on 24 attempts a world of seed 3, with the policy spiral.
"""

import argparse
from pathlib import Path
from typing import Any

import jax
import numpy as np

import mjx_fit as mf
from mjx_fit.config.files import read_config
from mjx_fit.config.worlds import world_file
from mjx_fit.data.logs.consistency import inconsistencies
from mjx_fit.report import script
from mjx_fit.types import Felt

SIZES = (1, 3)


def main(out: Path, attempts: int, seed: int) -> None:
    told = {world: of_world(world, attempts, seed) for world in ("home", "forge", "bench")}
    script.save(out, {"seed": seed, "attempts": attempts, "worlds": told})


def of_world(world: str, attempts: int, seed: int) -> dict[str, Any]:
    config = read_config(world_file(world))
    felt = (
        mf.make_engine("native", config)
        .run(mf.draw_attempts(jax.random.key(seed), attempts, config=config))
        .felt
    )
    rows = [jax.tree.map(lambda leaf, i=i: np.asarray(leaf)[i], felt) for i in range(attempts)]
    return {
        f"logs of {size}": of_logs([rows[k : k + size] for k in range(0, attempts - size + 1, size)], config)
        for size in SIZES
    }


def of_logs(logs: list[list[Felt]], config: mf.Config) -> dict[str, Any]:
    found = [inconsistencies(log, config) for log in logs]
    refused = [[str(one) for one in log if one.severity == "refused"] for log in found]
    return {
        "logs": len(logs),
        "refused": sum(bool(log) for log in refused),
        "noted": sum(any(one.severity == "noted" for one in log) for log in found),
        "why": sorted({line for log in refused for line in log}),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT.json")
    parser.add_argument("--attempts", type=int, default=120, metavar="N")
    parser.add_argument("--seed", type=int, default=11, metavar="K")
    asked = parser.parse_args()
    main(asked.out, asked.attempts, asked.seed)
