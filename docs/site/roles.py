"""Sphinx roles of docstrings, such as ``:class:`~anystyle.types.Gaussians```, become links of the reference."""

import contextlib
import re
from typing import Any

import griffe

_ROLE = re.compile(r":(?:class|func|meth|mod|attr|data|exc):`(~?)([\w.]+)`")


class Roles(griffe.Extension):
    """Rewrites the docstring of every object that is collected."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Called by griffe once for each module, class, function and attribute."""
        if obj.docstring is None:
            return

        def link(match: re.Match[str]) -> str:
            name = match[2]
            shown = name.rpartition(".")[2] if match[1] else name
            with contextlib.suppress(griffe.NameResolutionError):  # a full name already
                name = obj.resolve(name)
            # Optional: what is not in the reference stays plain code.
            return f'<autoref optional identifier="{name}"><code>{shown}</code></autoref>'

        obj.docstring.value = _ROLE.sub(link, obj.docstring.value)
