"""File formats of Gaussian scenes, one a module."""
