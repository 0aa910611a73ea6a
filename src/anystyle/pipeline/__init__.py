"""The pipeline of ``anystyle stylize``: load a model, read views, encode, restyle, save."""
