"""The data sets that the paper trains on, and the command ``anystyle data``."""
