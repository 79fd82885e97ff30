"""The contracts: one file each, with the table of its `[contract]`, its layout and its terms."""
