"""Layers of visual geometry transformers that more than one backbone is made of."""
