"""A small world made by code, networks of a few million parameters that know it, and how both are trained."""
