"""One HTML file that shows a scene in several styles: no network, any browser, geometry once and colours per style."""

from anystyle.io.page.pack import PageCamera, PageStyle, write

__all__ = ["PageCamera", "PageStyle", "write"]
