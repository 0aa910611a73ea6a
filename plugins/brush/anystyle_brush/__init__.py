"""Brush strokes made of Gaussians."""
