"""The regulation of a fund: the law on a date, the required own funds, and the recovery.

`in_force` selects the rules of the valuation date; `position` has the Dutch standard model, and
`bases` the funding of a scheme of the United Kingdom. The numbers of a law are in the TOML files of
this folder, with the dates from which they apply.
"""
