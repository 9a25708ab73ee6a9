"""Bodies: shape files and embedded shapes, checked, with detail added by a seed."""

from scenarios.bodies.embedded import EMBEDDED
from scenarios.bodies.load import Body, body_digest, load_body

__all__ = ["EMBEDDED", "Body", "body_digest", "load_body"]
