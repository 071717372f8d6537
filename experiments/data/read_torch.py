"""Read a data set in a PyTorch DataLoader: padded traces, lengths, and hole offsets from the estimate.

    python experiments/data/read_torch.py DIR

Requires torch, numpy and h5py, but not this library.
"""

# h5py has no static types for named members.
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportArgumentType=false
# pyright: reportCallIssue=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportMissingImports=false

import json
import sys
from pathlib import Path

import h5py
import torch
from torch.utils.data import DataLoader, Dataset


class Interactions(Dataset):
    """Data set with one item per valid interaction: wrench (J, 50, 6), length, hole offset (2,), match.

    Shards are opened on first use, so that every worker of a DataLoader has its own file handles.
    """

    def __init__(self, folder: Path):
        manifest = json.loads((folder / "manifest.json").read_text())
        self.paths = [folder / shard["name"] for shard in manifest["shards"]]
        self.open: dict[Path, h5py.File] = {}
        self.rows = []
        for path in self.paths:
            with h5py.File(path, "r") as shard:
                good = shard["valid"][:] & (shard["length"][:] > 0)
                self.rows += [(path, row) for row in range(len(good)) if good[row]]

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, index: int):
        path, row = self.rows[index]
        if path not in self.open:
            self.open[path] = h5py.File(path, "r")
        shard = self.open[path]
        length = int(shard["length"][row])
        wrench = torch.from_numpy(shard["trace/wrench_sensor"][row] - shard["tare_sensor"][row])
        wrench[length:] = 0  # padding
        offset = torch.from_numpy(shard["hole_pos_world"][row] - shard["estimate_world"][row])
        return wrench, length, offset, bool(shard["peg_type"][row] == shard["hole_type"][row])


def main(folder: Path) -> None:
    data = Interactions(folder)
    print(f"{len(data)} interactions")
    shuffled = torch.Generator().manual_seed(0)
    for wrench, length, offset, match in DataLoader(data, batch_size=16, shuffle=True, generator=shuffled):
        error_mm = 1000 * offset.norm(dim=1).mean()
        print(f"wrench {tuple(wrench.shape)}, lengths {length.min()} to {length.max()}, ", end="")
        print(f"estimates off by {error_mm:.1f} mm on average, {int(match.sum())} matched")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(f"usage: python {sys.argv[0]} DIR")
    main(Path(sys.argv[1]))
