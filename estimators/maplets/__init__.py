"""Navigation by maplets: patches of height and albedo after Gaskell et al. (2008), rendered and correlated."""
