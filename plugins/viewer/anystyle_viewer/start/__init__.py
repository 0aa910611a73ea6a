"""The page of ``anystyle view`` without an input: photographs are dropped, and scenes are made, shown and kept."""
