"""Plugins that break one promise each."""
