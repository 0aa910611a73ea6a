"""The contract of the kinds that this package declares."""
