"""Two hundred damaged or odd logs, made from good ones: refused, or how far their posteriors are off.

    python experiments/logs/damaged.py OUT.json [--logs N] [--seed K]

Each log holds three simulated attempts at holes that do not match, as a table of a robot that rests in free
space before each. It is damaged in one way, by a random amount, and imported with the map of the good log.
What is accepted is read by the sensor that ships; its posteriors are compared with those of the good log, and
with the truth.
"""

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import yaml
from damages import DAMAGES, Rows
from robot_logs import map_of_table, recorded, table_of

import mjx_fit as mf
from mjx_fit.data.logs import LoggedAttempt, import_log, read_map
from mjx_fit.evaluation.scores import inside
from mjx_fit.filters.updates import detected_belief
from mjx_fit.report import script
from mjx_fit.sensors.pose import start_of
from mjx_fit.task.logged_attempt import padded
from mjx_fit.types import Felt
from mjx_fit.utils import numerics

PER_LOG, STEPS = 3, 120


def main(out: Path, count: int, seed: int) -> None:
    rng, sensor = np.random.default_rng(seed), mf.load_sensor()
    update = mf.filter_update(sensor.config, sensor.network, logged=True)
    logs = -(-count // len(DAMAGES))
    attempts, truth = simulated(PER_LOG * logs, seed)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder)
        (path / "map.yaml").write_text(yaml.safe_dump(map_of_table()))
        said = read_map(path / "map.yaml")
        for number in range(count):
            damage, first = DAMAGES[number % len(DAMAGES)], PER_LOG * (number // len(DAMAGES))
            some, true = attempts[first : first + PER_LOG], truth[first : first + PER_LOG]
            own = recorded(some, noise_n=0.1, seed=number)
            clean = imported(path, table_of(own), said)[0]
            damaged = table_of(own)
            by = damage(damaged, own, rng)
            got, lines = imported(path, damaged, said)
            rows.append(
                {"damage": damage.__name__, "by": by, "findings": lines, "attempts": len(got)}
                | compared(got, clean, true, update)
            )
            print(number + 1, damage.__name__, by, rows[-1]["worst"], lines[:1], flush=True)
    script.save(out, {"seed": seed, "summary": summary(rows), "rows": rows})


def simulated(n: int, seed: int) -> tuple[list[Felt], np.ndarray]:
    """Return failed attempts with crosses at holes that do not match, and where the holes are."""
    drawn = mf.draw_attempts(jax.random.key(seed), 12 * n)
    peg, hole = np.asarray(drawn.peg_type), np.asarray(drawn.hole_type)
    which = np.flatnonzero((peg == 0) & (hole != 0))[:n]
    felt = mf.make_engine("native").run(jax.tree.map(lambda leaf: leaf[which], drawn)).felt
    rows = [jax.tree.map(lambda leaf, i=i: np.asarray(leaf)[i], felt) for i in range(len(which))]
    rows = [replace(row, start=start_of(row, mf.Config())) for row in rows]
    return rows, np.asarray(drawn.hole_pos_world)[which]


def imported(path: Path, rows: Rows, said: Any) -> tuple[list[LoggedAttempt], list[str]]:
    rows.to_csv(path / "log.csv", index=False)
    try:
        got = import_log(path / "log.csv", said, mf.Config())
    except mf.RequestError as error:
        return [], [f"refused: {error}"]
    return list(got.attempts), [str(finding) for finding in got.findings]


def compared(
    got: list[LoggedAttempt], clean: list[LoggedAttempt], truth: np.ndarray, update: Any
) -> dict[str, Any]:
    """Compare each posterior with that of the good log, in its standard deviations, and with the truth."""
    if not got:
        return {"worst": None, "inside": [], "inside_clean": []}
    begins = np.array([one.begin_s for one in clean])
    pairs = [(one, int(np.abs(begins - one.begin_s).argmin())) for one in got]
    after = posteriors([one.felt for one, _ in pairs], update)
    before = posteriors([clean[i].felt for _, i in pairs], update)
    true = truth[[i for _, i in pairs]]
    mean, cov = np.asarray(before.mean_world, float), np.asarray(before.cov, float)
    away = np.asarray(after.mean_world, float) - mean
    worst = np.sqrt(np.einsum("ni,nij,nj->n", away, np.linalg.inv(cov), away)).max()
    held = [squared_of(one, true) for one in (after, before)]
    found, clean_found = ([bool(yes) for yes in inside(one, 0.9)] for one in held)
    return {"worst": round(float(worst), 3), "inside": found, "inside_clean": clean_found}


def posteriors(felt: list[Felt], update: Any) -> mf.Belief:
    # Always as many: one compilation.
    felt = [*felt, *[felt[0]] * (2 * PER_LOG - len(felt))]
    same = [padded(one, STEPS) for one in felt]
    batch = jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *same)
    prior = jax.tree.map(np.asarray, detected_belief(jnp.asarray(batch.estimate_world), mf.Config()))
    return update(prior, batch, jax.random.split(numerics.key(0), len(felt)))


def squared_of(belief: mf.Belief, truth: np.ndarray) -> np.ndarray:
    n = len(truth)
    away = truth - np.asarray(belief.mean_world, float)[:n]
    return np.einsum("ni,nij,nj->n", away, np.linalg.inv(np.asarray(belief.cov, float)[:n]), away)


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return, for each damage, how many logs are refused, and what the others' posteriors are worth."""
    told = {}
    for name in [damage.__name__ for damage in DAMAGES]:
        own = [row for row in rows if row["damage"] == name]
        taken = [row for row in own if row["attempts"]]
        flat = [yes for row in taken for yes in row["inside"]]
        clean = [yes for row in taken for yes in row["inside_clean"]]
        told[name] = {
            "logs": len(own),
            "refused": len(own) - len(taken),
            "worst_stds": max((row["worst"] for row in taken), default=None),
            "median_stds": float(np.median([row["worst"] for row in taken])) if taken else None,
            "inside_90": float(np.mean(flat)) if flat else None,
            "inside_90_clean": float(np.mean(clean)) if clean else None,
        }
    return told


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT.json")
    parser.add_argument("--logs", type=int, default=204, metavar="N")
    parser.add_argument("--seed", type=int, default=0, metavar="K")
    asked = parser.parse_args()
    main(asked.out, asked.logs, asked.seed)
