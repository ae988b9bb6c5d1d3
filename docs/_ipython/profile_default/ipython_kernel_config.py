"""Figures of the site's pages are drawings, sharp on any screen."""

c = get_config()  # noqa: F821
c.InlineBackend.figure_formats = {"svg"}
# The page keeps its own margins; constrained layout leaves nothing to cut off.
c.InlineBackend.print_figure_kwargs = {"bbox_inches": None}
