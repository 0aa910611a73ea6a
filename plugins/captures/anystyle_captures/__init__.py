"""Cameras and fitted Gaussians from photographs."""
