"""Things that are built once from a scenario's shape and lent to estimators: landmark data bases."""

from campaign.products.shelf import Shelf, product_key

__all__ = ["Shelf", "product_key"]
