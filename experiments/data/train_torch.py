"""Learn where the hole is from what was felt, in PyTorch, by ``python train_torch.py DATA.npz [EPOCHS]``.

DATA.npz comes from ``mjx-fit data export``; PyTorch and NumPy are all that is needed.
"""

# pyright: reportMissingImports=false

import sys

import numpy as np
import torch

path, *epochs = sys.argv[1:]
data = np.load(path)
failed = ~data["inserted"]
force = data["trace_wrench_sensor"][failed].mean(2) - data["tare_sensor"][failed][:, None]
offset = data["trace_tip_pos_world"][failed][..., :2] - data["estimate_world"][failed][:, None, :2]
felt = torch.tensor(np.concatenate([0.1 * force, 100 * offset], -1), dtype=torch.float32)
real = np.arange(felt.shape[1]) < data["length"][failed][:, None]
felt = torch.where(torch.tensor(real)[..., None], felt, 0.0)
away = torch.tensor(100 * (data["hole_pos_world"] - data["estimate_world"][:, :2])[failed])  # cm

train, test = slice(0, 4 * len(felt) // 5), slice(4 * len(felt) // 5, None)
width = felt[0].numel()
model = torch.nn.Sequential(
    torch.nn.Flatten(), torch.nn.Linear(width, 64), torch.nn.GELU(), torch.nn.Linear(64, 2)
)
optimiser = torch.optim.AdamW(model.parameters(), 1e-3, weight_decay=0.1)
for _ in range(int(epochs[0]) if epochs else 200):
    loss = (model(felt[train]) - away[train]).square().mean()
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()
with torch.no_grad():
    error = (model(felt[test]) - away[test]).norm(dim=1).median()
print(f"median error {error:.2f} cm, of the detection {away[test].norm(dim=1).median():.2f} cm")
