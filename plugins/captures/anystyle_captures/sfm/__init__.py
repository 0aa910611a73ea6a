"""Structure from motion: cameras and sparse points from photographs, and how far they can be trusted."""
