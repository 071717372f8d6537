"""The two rates that everything runs at: torques and wrenches at 500 Hz, commands at 10 Hz."""

STEP_S = 0.002
"""Duration of one simulation step."""

SUBSTEPS = 50
"""Simulation steps in one action: the samples of one wrench window."""

ACTION_S = 0.1
"""Duration of one action."""
