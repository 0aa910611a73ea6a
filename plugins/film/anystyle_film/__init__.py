"""Films of scenes: where the camera goes, how a frame is rendered, and metadata for players."""
