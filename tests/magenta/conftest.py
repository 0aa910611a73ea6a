"""Makes the plugin's package importable the way a user's session does: through the catalog."""

from anystyle.registry.catalog import catalog

catalog().find("injector", "magenta").load()
