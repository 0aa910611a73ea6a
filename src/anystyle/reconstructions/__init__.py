"""How scenes come to be from photographs: cameras by structure from motion, Gaussians by fitting."""
