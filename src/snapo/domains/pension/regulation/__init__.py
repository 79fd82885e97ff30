"""A fund before its regulator: the law of a date, own funds required, and ways to recover.

`in_force` selects the rules of the valuation date; `position` has the Dutch standard model, and
`bases` the funding of a scheme of the United Kingdom. The numbers of a law are in the TOML files of
this folder, with the dates from which they hold.
"""
