"""The contracts of plugins, one class for each kind; if you read one thing, read this folder, in this order.

1. :mod:`~anystyle.contracts.backbone`: the five parts of a feed-forward reconstruction network
2. :mod:`~anystyle.contracts.style`: style encoders, the injectors and placements by which style enters a network, and
   what predicts styled attributes
3. :mod:`~anystyle.contracts.cameras`: cameras that programs stored for photographs, and cameras that are estimated
4. :mod:`~anystyle.contracts.scene`: scenes and styles to learn from and to be judged on, reconstructions, methods by
   which a scene takes a style, and renderers
5. :mod:`~anystyle.contracts.scores`: losses, metrics and the correspondence of pixels
6. :mod:`~anystyle.contracts.training` and :mod:`~anystyle.contracts.protocol`: what learns, and how it is judged
7. :mod:`~anystyle.contracts.format` and :mod:`~anystyle.contracts.command`: files, and commands of the command line

A plugin inherits from one of these classes, implements its abstract methods and is listed in one line of TOML.
``anystyle.testing`` holds each contract as plain functions; ``anystyle plugins check`` runs them, on an instance built
with the options of :meth:`Pluggable.example <anystyle.registry.catalog.Pluggable.example>`, the defaults unless
overridden. Names are imported when they are first asked for: a command needs no torch, and only trainings Lightning.
"""

from anystyle import lazy

__getattr__, __dir__, __all__ = lazy.stub(__name__, __file__)
