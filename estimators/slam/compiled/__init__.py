"""The windowed adjustment as machine code: numba kernels over flat arrays, strict IEEE arithmetic, one thread."""
