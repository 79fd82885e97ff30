"""What every domain's report is made of: a page, charts as SVG, tables, numbers with units."""
