"""Pages: one HTML file each, which loads nothing from elsewhere and needs no server.

A page extends `base.html.j2` (head, colours for light and dark, tables that sort and filter) and
fills its blocks `title`, `style`, `main` and `script`. To add one, write its template beside the
base, and a function that gathers its data and calls `exact_mdp.analysis.pages.page.render`.
"""
