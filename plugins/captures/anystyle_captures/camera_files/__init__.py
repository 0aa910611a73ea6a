"""Cameras that other programs stored beside photographs."""
