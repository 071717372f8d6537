"""Sample rates: torques and wrenches at 500 Hz, commands at 10 Hz; and the memory that a trace takes."""

STEP_S = 0.002
"""Duration of one simulation step, s."""

SUBSTEPS = 50
"""Simulation steps per action, equal to the samples per wrench window."""

ACTION_S = 0.1
"""Duration of one action, s."""

ACTION_BYTES = 4 * (SUBSTEPS * 6 + 3 + 4 + 3 + 3 + 3)
"""Memory per action in a ``Trace``, bytes."""
