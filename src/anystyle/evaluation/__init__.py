"""Evaluation: protocols that turn a model or folders of images into figures, and the tables made of them."""
