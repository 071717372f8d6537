"""Compare contact detection from force with the simulator's contact flag.

    python experiments/physics/contact_bit.py DATA...

DATA are data sets that predate contact detection from force, such as experiments/data/sample. Their files
hold the simulator's flag: True if a contact force acted at any step of the action. Sensor noise is added.
"""

import sys
from pathlib import Path

import h5py
import jax
import numpy as np

import mjx_fit as mf
from mjx_fit.sensors.force_torque import in_contact, measured

BIAS_N = (0.0, 0.5, 1.0, 2.0)
"""Tare errors in F_x, N."""


def main(folders: list[Path]) -> None:
    """Print a line for each tare error."""
    wrench, simulated = [], []
    for path in sorted(path for folder in folders for path in folder.glob("*.h5")):
        with h5py.File(path) as file:
            names = ("length", "tare_sensor", "trace/contact", "trace/wrench_sensor")
            length, tare, contact, clean = (np.asarray(file[name]) for name in names)
        real = np.arange(contact.shape[1]) < length[:, None]
        wrench.append((clean - tare[:, None, None])[real])
        simulated.append(contact[real])
    clean, touched = np.concatenate(wrench), np.concatenate(simulated)
    for bias in BIAS_N:
        shifted = clean + np.array([bias, 0, 0, 0, 0, 0], np.float32)
        noisy = measured(shifted, np.zeros(6, np.float32), jax.random.key(0), mf.Config().wrist)
        told = np.asarray(in_contact(noisy, mf.Config().wrist))
        missed, invented = int((touched & ~told).sum()), int((~touched & told).sum())
        there, none = touched.sum(), (~touched).sum()
        print(f"bias {bias} N: missed {missed} of {there} contacts, false alarms {invented} of {none}")


if __name__ == "__main__":
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    mf.configure()
    main([Path(folder) for folder in sys.argv[1:]])
