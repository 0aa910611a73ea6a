"""Injectors: how style changes the tokens at a site."""
