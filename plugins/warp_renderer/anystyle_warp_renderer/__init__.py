"""A rasteriser for graphics cards without a compiler: kernels in Python, which NVIDIA's Warp compiles as they run."""
