"""How the tiny networks are judged."""
