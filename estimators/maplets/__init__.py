"""Navigation by maplets: height and albedo patches after Gaskell et al. (2008), rendered and correlated."""
