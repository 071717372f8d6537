"""Measure robosuite, the paper's stack, with one world: Panda, operational-space control, 10 Hz, 500 Hz.

robosuite pins an older MuJoCo, so the script runs in a separate environment and does not use mjx_fit:

    python -m venv robosuite-env
    robosuite-env/bin/pip install "robosuite>=1.5,<1.6" "mujoco>=3.3,<3.4"
    robosuite-env/bin/python experiments/physics/robosuite_speed.py
"""

# pyright: reportMissingImports=false
import json
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np
import robosuite

ACTIONS = 100
TIMES = 3


def main() -> None:
    """Time actions of robosuite's lifting task with the arm moving freely above the table."""
    control = robosuite.load_composite_controller_config(controller="BASIC")
    env = robosuite.make(
        "Lift",
        robots="Panda",
        controller_configs=control,
        has_renderer=False,
        has_offscreen_renderer=False,
        use_camera_obs=False,
        control_freq=10,
        horizon=10**9,
    )
    env.reset()
    action = np.zeros(env.action_dim)
    action[2] = -0.1
    env.step(action)
    seconds = []
    for _ in range(TIMES):
        began = time.perf_counter()
        for _ in range(ACTIONS):
            env.step(action)
        seconds.append(time.perf_counter() - began)
    substeps = round(env.control_timestep / env.model_timestep)
    row = {
        "name": "robosuite",
        "worlds": 1,
        "physics_steps_per_s": round(ACTIONS * substeps / min(seconds)),
        "actions_per_s": round(ACTIONS / min(seconds), 1),
        "versions": {name: version(name) for name in ("robosuite", "mujoco", "numpy")},
    }
    text = json.dumps(row, indent=1)
    Path(__file__).with_name("robosuite.json").write_text(text + "\n")
    print(text)


if __name__ == "__main__":
    main()
