"""From names to objects: the catalog of plugins, schemas made of signatures, and the one door that builds."""
