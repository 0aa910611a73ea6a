"""The catalog of plugins, schemas made from constructor signatures, and building plugins."""
