"""Tables of printed cells."""
