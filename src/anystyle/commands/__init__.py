"""The commands, one module each; a module's first line describes it in ``anystyle --help``."""
