"""Films of scenes: where the camera goes, how a frame is rendered, and what players are told."""
