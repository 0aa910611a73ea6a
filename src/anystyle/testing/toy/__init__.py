"""The smallest honest plugin of each kind: what contracts are tested on, and what new plugins begin as."""
