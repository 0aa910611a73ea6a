"""Metrics: each a ``torchmetrics.Metric`` that is usable on its own."""
