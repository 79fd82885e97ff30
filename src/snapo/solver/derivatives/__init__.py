"""The derivative of the value that is reported, and the interval that contains the true one.

It contains two errors: of finitely many paths (`by_block`, `changes`), and of a policy which is
only near the best one (`surface`, `margin`). `bump` moves inputs with the policy reacting, and
`verdict` decides by it.
"""
