"""Images of a scenario, rendered or real, and the observations made of them."""
