"""NumPy's npz: the fields of all episodes under their names in a shard."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from mjx_fit.config.schema import config_from_stored
from mjx_fit.data.episode import happened
from mjx_fit.data.hdf5 import flat
from mjx_fit.data.hdf5_fields import fields_of, kind_of
from mjx_fit.data.manifest import Manifest
from mjx_fit.data.reader import load


def write_npz(folder: Path, manifest: Manifest, path: Path) -> None:
    """Write the fields with ``_`` for ``/``, and ``about``, JSON with their units and the request."""
    data = load(folder)
    keep, config = happened(data), config_from_stored(manifest.request["config"])
    kind = kind_of(manifest.request)
    arrays: dict[str, Any] = {
        name.replace("/", "_"): value[keep] for name, value in flat(data, config, kind).items()
    }
    about = {name.replace("/", "_"): field._asdict() for name, field in fields_of(config, kind).items()}
    about |= {"shapes": list(manifest.shapes), "request": manifest.request, "versions": manifest.versions}
    with path.open("wb") as file:  # savez would append .npz to a temporary file name
        np.savez_compressed(file, about=np.array(json.dumps(about)), **arrays)
