"""The smallest plugin of each kind that this package declares."""
