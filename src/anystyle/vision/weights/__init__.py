"""Files of weights by name: where each comes from, where it is searched, under what licence, and reading them.

A missing file raises, and nothing is downloaded unless ``anystyle weights download`` is run. The rows are those of
``weights.toml`` in this folder and beside the top-level module of each plugin package, whose bundled files are in its
folder ``assets``.
"""

from anystyle import lazy

__getattr__, __dir__, __all__ = lazy.stub(__name__, __file__)
