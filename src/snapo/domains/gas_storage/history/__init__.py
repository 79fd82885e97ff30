"""Price history: the likelihood of Gaussian price models, their estimates, and tests of a policy.

Estimates: `model` states a model in the form that the filter of `kalman` needs, `maximum` and `fit`
find the largest likelihood, `read` reads the files, `calibrate` is the command. Back-tests:
`observed` has the prices by date, `rule` decides a day, `recalibrate` estimates the model again,
`hedged` trades hedges, `backtest` is the command with the records of `results`; `table` is
`[backtest]`.
"""
