"""Checkpoints, data folders and camera paths of nerfstudio."""
