"""Page of a reproduced paper."""
