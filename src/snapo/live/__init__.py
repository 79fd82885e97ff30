"""The page of `snapo open`: inputs of a run are moved, and its trained policy is valued again.

`open` starts `server`, which talks to pages, and through `process` to `worker`, the process that
computes. There `positions` finds where an input is in the files of the case, and `valuation` rolls
the policy over the same paths.
"""
