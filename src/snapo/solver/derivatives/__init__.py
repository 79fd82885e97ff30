"""The derivative of the value that is reported, and the interval that contains the true one.

The interval covers two errors: that of a finite number of paths (`by_block`, `changes`), and that
of a policy which is only near the best one (`surface`, `margin`). `bump` moves inputs with the
policy reacting, and `verdict` decides by the result.
"""
