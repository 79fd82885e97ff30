"""The parts of the reports of all domains: pages, charts as SVG, tables, and numbers with units.

`folder.RunFiles` reads a run, a section turns it into blocks of `page`, and `page.render` writes
one file. `rows` makes tables and bar charts of a chapter's records; the drawing functions are in
`charts`, `bands` and `drawing`.
"""
