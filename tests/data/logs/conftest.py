"""Attempts that logs are made of."""

from dataclasses import replace

import jax
import numpy as np
import pytest

import mjx_fit as mf
from mjx_fit.sensors.pose import start_of

CONFIG = mf.Config()


@pytest.fixture(scope="session")
def attempts():
    """Three failed attempts: spirals at holes of other types."""
    drawn = mf.draw_attempts(jax.random.key(3), 24)
    apart = np.flatnonzero(np.asarray(drawn.peg_type) != np.asarray(drawn.hole_type))[:3]
    felt = mf.make_engine("native").run(jax.tree.map(lambda leaf: leaf[apart], drawn)).felt
    rows = [jax.tree.map(lambda leaf, i=i: np.asarray(leaf)[i], felt) for i in range(len(apart))]
    return [replace(row, start=start_of(row, CONFIG)) for row in rows]
