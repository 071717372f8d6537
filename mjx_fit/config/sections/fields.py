"""Types shared by several configuration sections: ranges, and units for keys whose names carry none."""

from typing import Annotated, Any

from pydantic import ConfigDict, Field

STRICT = ConfigDict(extra="forbid", strict=True)

PER_S2_UNIT: dict[str, Any] = {"unit": "1/s²"}
ACTIONS_UNIT: dict[str, Any] = {"unit": "actions"}
ATTEMPTS_UNIT: dict[str, Any] = {"unit": "attempts"}
EPOCHS_UNIT: dict[str, Any] = {"unit": "epochs"}

LEAST_PROBABILITY = 1e-6
Probability = Annotated[float, Field(ge=LEAST_PROBABILITY, le=0.999999)]
"""Probability bounded away from 0 and 1 by what single precision resolves well."""
