"""Correspondences by optical flow: RAFT, with a search in windows in its place."""
