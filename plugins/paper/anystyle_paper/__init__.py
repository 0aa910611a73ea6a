"""The tables of the AnyStyle paper: folders, protocols, published figures, and the command ``anystyle report``."""
