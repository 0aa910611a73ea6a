"""Files of Gaussians beside PLY, one a module: each writes :class:`anystyle.io.ply.Splats` in the axes they have."""
