"""Meshes of Gaussian scenes."""
