"""Files in and out: PLY, COLMAP, video, sheets, checkpoints, what a run leaves."""
