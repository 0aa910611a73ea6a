"""A rasteriser for processors: kernels compiled by numba, with gradients written by hand."""
