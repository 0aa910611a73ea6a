"""Reconstructions: from views to the scene that is styled."""
