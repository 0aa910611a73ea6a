"""Renderers: one 3DGS rasteriser a file."""
