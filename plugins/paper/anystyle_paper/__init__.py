"""The tables of the AnyStyle paper: folders, protocols, published scores, and the command ``anystyle report``."""
