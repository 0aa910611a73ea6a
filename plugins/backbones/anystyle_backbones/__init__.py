"""Reconstruction networks as plugins of kind ``backbone``, and the layers that they share."""
