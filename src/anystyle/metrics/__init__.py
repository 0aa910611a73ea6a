"""Metrics: each a ``torchmetrics.Metric`` that is usable on its own.

``metric.update(comparison)`` takes in, ``metric.compute()`` gives the figures over all, and ``metric(comparison)`` both
takes in and gives the figures of this comparison alone. ``metric.stand_ins`` names the figures that rest on a stand-in.
"""
