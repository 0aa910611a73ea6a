"""Reading and writing files: PLY, COLMAP, video, contact sheets, checkpoints, JSON and YAML."""
