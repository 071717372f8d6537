"""Opens an export as robomimic does, up to a trained policy; run by test_export_readers in its environment.

torchvision, which robomimic imports for pictures alone, is replaced by modules that hold nothing.
"""

# pyright: reportMissingImports=false

import json
import sys
import types
from importlib.metadata import version


def _without(name: str) -> None:
    def missing(what: str) -> type:
        if what.startswith("__"):
            raise AttributeError(what)
        return type(what, (), {})

    module = types.ModuleType(name)
    module.__getattr__ = missing  # type: ignore[method-assign]
    sys.modules[name] = module
    parent, _, child = name.rpartition(".")
    if parent:
        setattr(sys.modules[parent], child, module)


for one in (
    "torchvision",
    "torchvision.transforms",
    "torchvision.transforms.functional",
    "torchvision.models",
):
    _without(one)


def main(hdf5: str, npz: str) -> None:
    import numpy as np
    import torch
    from robomimic.algo import algo_factory
    from robomimic.config import config_factory
    from robomimic.envs.env_base import EnvType
    from robomimic.utils import file_utils, obs_utils
    from robomimic.utils.dataset import SequenceDataset
    from torch.utils.data import DataLoader

    meta = file_utils.get_env_metadata_from_dataset(hdf5)
    assert meta["type"] in vars(EnvType).values()
    keys = [
        "contact",
        "tip_angvel_world",
        "tip_linvel_world",
        "tip_pos_world",
        "tip_quat_world",
        "wrench_sensor",
    ]
    config = config_factory("bc")
    with config.values_unlocked():
        config.observation.modalities.obs.low_dim = keys
    obs_utils.initialize_obs_utils_with_config(config)
    shapes = file_utils.get_shape_metadata_from_dataset(hdf5)
    assert sorted(shapes["all_obs_keys"]) == keys

    def read(side: str | None, **how) -> SequenceDataset:
        columns = ("actions", "rewards", "dones")
        return SequenceDataset(hdf5, keys, columns, filter_by_attribute=side, hdf5_cache_mode="all", **how)

    sides = {side: read(side, seq_length=4, frame_stack=2) for side in ("train", "valid")}
    whole = read(None)
    next(iter(DataLoader(sides["valid"], batch_size=4)))
    model = algo_factory(
        "bc", config, obs_key_shapes=shapes["all_shapes"], ac_dim=shapes["ac_dim"], device=torch.device("cpu")
    )
    model.set_train()
    batch = next(iter(DataLoader(read("train", hdf5_normalize_obs=True), batch_size=32)))
    batch = model.process_batch_for_training(batch)
    losses = [float(model.train_on_batch(batch, 0)["losses"]["action_loss"]) for _ in range(20)]
    assert losses[-1] < losses[0]
    with np.load(npz, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    print(
        json.dumps(
            {
                "versions": {name: version(name) for name in ("robomimic", "torch", "numpy", "h5py")},
                "env_name": meta["env_name"],
                "seed": meta["env_kwargs"]["seed"],
                "shapes": dict(shapes["all_shapes"]),
                "action_width": shapes["ac_dim"],
                "sides": {side: sorted(read.demos) for side, read in sides.items()},
                "transitions": len(whole),
                "losses": [losses[0], losses[-1]],
                "npz": {name: [str(array.dtype), list(array.shape)] for name, array in arrays.items()},
                "about": sorted(json.loads(str(arrays["about"]))),
            }
        )
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
