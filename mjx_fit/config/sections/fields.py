"""Types of configuration values that several sections share: a range, and a unit where the name has none."""

from typing import Annotated, Any

from pydantic import ConfigDict, Field

STRICT = ConfigDict(extra="forbid", strict=True)

PER_S2_UNIT: dict[str, Any] = {"unit": "1/s²"}
ACTIONS_UNIT: dict[str, Any] = {"unit": "actions"}
ATTEMPTS_UNIT: dict[str, Any] = {"unit": "attempts"}
EPOCHS_UNIT: dict[str, Any] = {"unit": "epochs"}

LEAST_PROBABILITY = 1e-6
Probability = Annotated[float, Field(ge=LEAST_PROBABILITY, le=0.999999)]
"""As near to 0 and 1 as single precision can tell well."""
