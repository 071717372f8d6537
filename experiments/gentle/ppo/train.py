"""Train a policy by reinforcement with the recurrent PPO of sb3-contrib, and export it.

    pip install -e ".[gym,rl]"
    python experiments/gentle/ppo/train.py OUT [--task search] [--actions 10000000] [--minutes 100]
    python experiments/gentle/ppo/train.py OUT --task known --until 0.95

Tasks are those of `tasks.py`. The same command resumes after the last update that was saved. `OUT/curve.csv`
has a line for each update:
actions, seconds of this process, finished attempts, and the means of their insertions, lengths and returns.
`OUT/policy.npz` holds the weights that `policy.py` reads.
"""

import argparse
import csv
import time
from pathlib import Path

import numpy as np
import torch
from policy import ACTOR, acted, begun
from sb3_contrib import RecurrentPPO
from stable_baselines3.common.callbacks import BaseCallback
from tasks import Insertions, configs_of
from torch import nn

WORLDS, STEPS = 256, 64
"""Worlds, and actions of an update in each of them."""
SETTINGS = {
    "n_steps": STEPS,
    "batch_size": 4096,
    "n_epochs": 4,
    "learning_rate": 5e-4,
    "gamma": 0.99,
    "gae_lambda": 0.95,
    "ent_coef": 0.001,
    "target_kl": 0.05,
    "policy_kwargs": {
        "lstm_hidden_size": 128,
        "net_arch": {"pi": [128], "vf": [128]},
        "activation_fn": nn.Tanh,
        "log_std_init": -0.5,
    },
}


class Log(BaseCallback):
    """Write the learning curve, save each update, and stop after the one that is to be the last.

    It is the first one in which the time is over, or in which this share of the attempts was successful.
    """

    def __init__(self, out: Path, minutes: float, until: float):
        super().__init__()
        self._out, self._until, self._begun = out, until, time.monotonic()
        self._ends = self._begun + 60 * minutes
        self._inserted, self._lengths, self._returns, self._over = [], [], [], False

    def _on_rollout_start(self) -> None:
        if self.n_calls:  # the previous rollout has been learnt from
            keep(self.model, self._out)
            self._over |= time.monotonic() > self._ends

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if "inserted" in info:
                self._inserted.append(info["inserted"])
                self._lengths.append(info["episode"]["l"])
                self._returns.append(info["episode"]["r"])
        return not self._over

    def _on_rollout_end(self) -> None:
        row = [self.num_timesteps, round(time.monotonic() - self._begun, 1), len(self._inserted)]
        row += [round(float(np.mean(x)), 4) for x in (self._inserted, self._lengths, self._returns) if x]
        with (self._out / "curve.csv").open("a", newline="") as file:
            csv.writer(file).writerow(row)
        self._over = bool(self._inserted) and float(np.mean(self._inserted)) >= self._until
        self._inserted, self._lengths, self._returns = [], [], []

    def _on_training_end(self) -> None:
        if not self._over:
            keep(self.model, self._out)


def begun_or_resumed(out: Path, task: str) -> RecurrentPPO:
    """Return the model of the last saved update with new worlds, and cut the curve off there."""
    saved, curve = out / "model.zip", out / "curve.csv"
    if not saved.exists():
        curve.unlink(missing_ok=True)
        worlds = Insertions(WORLDS, configs_of(task), seed=0)
        return RecurrentPPO("MlpLstmPolicy", worlds, device="cpu", seed=0, **SETTINGS)
    model = RecurrentPPO.load(saved, device="cpu")
    model.set_env(Insertions(WORLDS, configs_of(task), seed=model.num_timesteps))
    lines = curve.read_text().splitlines(keepends=True)
    curve.write_text("".join(line for line in lines if int(line.split(",")[0]) <= model.num_timesteps))
    return model


def keep(model, out: Path) -> None:
    """Save a checkpoint in place of the previous one."""
    model.save(out / "next.zip")
    (out / "next.zip").replace(out / "model.zip")


def export(model, out: Path) -> None:
    """Write the weights of the actor, and check that the policy made of them acts like the model."""
    weights = {name: value.cpu().numpy() for name, value in model.policy.state_dict().items()}
    actor = {name: weights[name] for name in weights if name.startswith(ACTOR)}
    np.savez(out, **actor)
    seen = np.random.default_rng(0).normal(size=(6, model.observation_space.shape[0])).astype(np.float32)
    own, state, first = begun(actor), None, np.ones(1, bool)
    for row in seen:
        action, state = model.predict(row[None], state, first, deterministic=True)
        own, mine = acted(actor, own, row)
        np.testing.assert_allclose(mine, action[0], atol=1e-4)
        first = np.zeros(1, bool)


def main(out: Path, task: str, actions: int, minutes: float, until: float) -> None:
    out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)  # threads that wait for each other cost more than they save beside other work
    model = begun_or_resumed(out, task)
    left = actions - model.num_timesteps
    if left > 0:
        model.learn(left, callback=Log(out, minutes, until), reset_num_timesteps=False)
        model = RecurrentPPO.load(out / "model.zip", device="cpu")
    export(model, out / "policy.npz")
    print(f"{out}: {model.num_timesteps:,} of {actions:,} actions")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("--task", choices=("search", "known"), default="search")
    parser.add_argument("--actions", type=int, default=10_000_000, metavar="N")
    parser.add_argument("--minutes", type=float, default=1e6, metavar="M", help="stop after this long")
    parser.add_argument("--until", type=float, default=2.0, metavar="SHARE", help="or with this success")
    asked = parser.parse_args()
    main(asked.out, asked.task, asked.actions, asked.minutes, asked.until)
