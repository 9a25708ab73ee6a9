"""The base of every model of the schema."""

from pydantic import BaseModel, ConfigDict


class SpecModel(BaseModel):
    """Frozen; unknown keys and non-finite numbers are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)
