"""The smallest plugin of each kind: contracts are tested on them, and ``anystyle plugins new`` copies them."""
