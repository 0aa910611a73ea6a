"""Placements: which sites of a backbone style enters."""
