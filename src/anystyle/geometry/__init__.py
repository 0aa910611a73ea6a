"""Pure functions of cameras, rotations, colours and projections."""
