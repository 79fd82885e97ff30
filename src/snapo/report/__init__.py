"""The parts of the reports of all domains: a page, charts as SVG, tables, numbers with units.

`folder.RunFiles` reads a run, a section turns it into blocks of `page`, and `page.render` writes
one file. `rows` makes tables and ladders of a chapter's records; the painters are in `charts`,
`bands` and `drawing`.
"""
