"""An orbit about a small body, as navigation by craters sees it: gravity, light, rotation, motion and measurements."""
