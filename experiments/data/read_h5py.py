"""Read a data set with h5py alone: print the fields of a shard and the forces of one rollout.

    python experiments/data/read_h5py.py DIR

The script does not use this library: copy any part of it.
"""

# h5py has no static types for named members.
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportArgumentType=false
# pyright: reportCallIssue=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false

import json
import sys
from pathlib import Path

import h5py
import numpy as np


def main(folder: Path) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    if not manifest["complete"]:
        sys.exit(f"{folder} is not complete")
    print(f"{manifest['request']['episodes']} rollouts, policy {manifest['request']['policy']}")
    first = folder / manifest["shards"][0]["name"]
    with h5py.File(first, "r") as shard:
        shapes = list(shard.attrs["shapes"])
        print(f"\n{first.name}:")
        shard.visititems(describe)

        length = shard["length"][:]  # J differs between interactions; the rest of a row is padding
        i = int(np.argmax(length))
        peg, hole = (shapes[shard[name][i]] for name in ("peg_type", "hole_type"))
        print(f"\nepisode {shard['episode'][i]}: {peg} in {hole}, {length[i]} actions")

        # The F/T sensor measures the peg's weight too: subtract the reading at rest.
        wrench = shard["trace/wrench_sensor"][i, : length[i]] - shard["tare_sensor"][i]
        force = np.linalg.norm(wrench[..., :3], axis=-1).ravel()  # 500 Hz
        off = shard["estimate_world"][i] - shard["hole_pos_world"][i]
        print(f"estimate off by {1000 * np.hypot(*off):.1f} mm")
        print(f"force: median {np.median(force):.1f} N, peak {force.max():.1f} N")


def describe(name: str, item: h5py.Dataset | h5py.Group) -> None:
    if isinstance(item, h5py.Dataset):
        about = item.attrs
        print(f"  {name:24} {item.shape!s:18} [{about['unit']}] {about['frame']:6} {about['meaning']}")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(f"usage: python {sys.argv[0]} DIR")
    main(Path(sys.argv[1]))
