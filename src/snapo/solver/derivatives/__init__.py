"""Which derivative of the value is reported, and the interval that contains the true one.

Two errors are in it: that of finitely many paths (`by_block`, `changes`), and that of a policy
which is near the best one only (`surface`, `margin`). `bump` moves inputs with the policy reacting,
and `verdict` decides by it.
"""
