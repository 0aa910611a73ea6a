"""Scenes and captioned style images that are made on the fly, the same on every machine.

The generators use seeded integers, the four operations, square roots and polynomials of their own: what IEEE 754
fixes to the bit, and no function of a system's mathematics library.
"""
