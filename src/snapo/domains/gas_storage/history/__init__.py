"""Price history: the likelihood of Gaussian price models, their estimates, and back-tests of a
policy.

Estimates: `model` has the models in the form that the filter of `kalman` needs, `maximum` maximises
the likelihood, `read` reads the files, and `calibrate` is the command. Back-tests: `observed` has
the prices by date, `rule` decides the flow of a day, `recalibrate` estimates the model again,
`hedged` trades hedges, `backtest` is the command, `results` and `report` have its results, and
`table` is `[backtest]`.
"""
