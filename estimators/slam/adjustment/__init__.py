"""The windowed adjustment: its problem, compiled solver, marginalisation, and the map that it is made from."""
