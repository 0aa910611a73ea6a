"""Metrics that the benchmark adds to those of anystyle; each is a plugin of kind ``metric``."""
