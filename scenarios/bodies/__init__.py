"""Bodies: shape files and built-in shapes, checked, with optional random surface detail."""

from boresight.scenarios.bodies.embedded import EMBEDDED
from boresight.scenarios.bodies.load import Body, body_digest, detailed_count, expected_facets, load_body

__all__ = ["EMBEDDED", "Body", "body_digest", "detailed_count", "expected_facets", "load_body"]
