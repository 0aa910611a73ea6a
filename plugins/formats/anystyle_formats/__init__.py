"""File formats of Gaussian scenes, one per module."""
