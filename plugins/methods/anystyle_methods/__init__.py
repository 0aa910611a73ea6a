"""Losses and baselines of other methods of 3D stylization; see ``docs/rivals.md``."""
