"""Evaluation: protocols that turn a model or folders of images into scores, and the tables made of them."""
