"""The commands of ``anystyle study``, one a file."""
