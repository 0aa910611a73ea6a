"""Correspondences: where the pixels of one frame are seen in another."""
