"""Further metrics as plugins of kind ``metric``, and optical flow as correspondences."""
