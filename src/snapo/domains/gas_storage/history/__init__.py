"""Price history: the likelihood of Gaussian price models, their estimates, and tests of a policy.

`model` states a model in the form that the filter of `kalman` needs, `maximum` finds the largest
likelihood, `read` reads the files, `calibrate` joins them.
"""
