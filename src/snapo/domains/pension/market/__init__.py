"""The market of a fund: rates, inflation, spreads, currencies, and the return of every asset.

`dynamics.move` makes a step, with the models (`generated`) or from a file of scenarios
(`supplied`). Both return a `state.Move`, so that all other code is the same for both.
"""
