"""Correspondences by optical flow: RAFT, and DIS."""
