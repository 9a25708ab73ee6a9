"""The page of a whole paper."""
