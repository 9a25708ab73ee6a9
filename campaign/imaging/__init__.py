"""Images of a scenario, rendered or real, and the store of rendered ones."""
