"""Loop closure: landmarks that were seen before, as a revolution ago, are taken for what they are."""
