"""Opens an export as LeRobot does; run by test_export_readers in its environment."""

# In an environment of its own, which has them.
# pyright: reportMissingImports=false

import json
import sys
from importlib.metadata import version


def main(folder: str) -> None:
    import torch
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    data = LeRobotDataset("local/set", root=folder)
    batch = next(iter(torch.utils.data.DataLoader(data, batch_size=8)))
    first = data[0]
    print(
        json.dumps(
            {
                "versions": {name: version(name) for name in ("lerobot", "datasets", "torch")},
                "episodes": data.num_episodes,
                "frames": data.num_frames,
                "fps": data.fps,
                "shapes": {
                    name: list(value.shape) for name, value in batch.items() if hasattr(value, "shape")
                },
                "first_wrench": first["observation.wrench"][0].tolist(),
                "task": first["task"],
                "peg": first["peg"],
                "mean": data.meta.stats["observation.state"]["mean"].tolist(),
                "lengths": [int(one["length"]) for one in data.meta.episodes],
            }
        )
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
