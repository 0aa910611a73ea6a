"""Deprecated, and gone in 0.3: see :mod:`anystyle.contracts.backbone`."""

from anystyle.deprecated import moved

__getattr__ = moved(__name__, "anystyle.contracts.backbone")
