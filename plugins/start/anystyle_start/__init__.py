"""The page of ``anystyle start``: photographs are dropped, and scenes are made, shown and kept."""
