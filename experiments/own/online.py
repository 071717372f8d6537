"""Update a belief from one logged attempt: python experiments/own/online.py LOG.npz PEG X Y.

LOG.npz holds the arrays of ``mf.SensorLog``; (X, Y) is the detected hole position, m.
"""

import sys

import numpy as np

import mjx_fit as mf

log, peg, x, y = sys.argv[1:]
detected = np.array([[float(x), float(y)]])
tracker = mf.BeliefTracker(mf.load_sensor(), detected)
hole = tracker.choose(peg)
belief = tracker.update(hole, mf.SensorLog(**np.load(log)))
moved_cm = 100 * np.linalg.norm(belief.pos_mean_world - detected[0])
print(f"hole at {np.round(belief.pos_mean_world, 4)} m, {moved_cm:.2f} cm from the detection")
print(f"standard deviations {1000 * np.sqrt(np.diag(belief.pos_cov))} mm; types {belief.type_probability}")
