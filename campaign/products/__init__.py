"""Products that are built once from a scenario and used by estimators, such as landmark data bases."""

from boresight.campaign.products import landmark_database
from boresight.campaign.products.assets import (
    BuiltAssets,
    BuiltProduct,
    MissingProduct,
    OnboardShape,
    Prepared,
    product_key,
)

__all__ = [
    "BuiltAssets",
    "BuiltProduct",
    "MissingProduct",
    "OnboardShape",
    "Prepared",
    "landmark_database",
    "product_key",
]
