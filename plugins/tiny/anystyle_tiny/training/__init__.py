"""How the tiny networks are trained."""
