"""The page of `snapo open`: a user moves the inputs of a run, and its trained policy is valued
again.

`open` starts `server`, which exchanges messages with pages and, through `process`, with `worker`,
the process that computes. In the worker, `valuation` values the policy on the same paths.
"""
