"""The change of value between two runs of a contract, in parts: `snapo explain`."""

NOT_AS_PLANNED = (
    "the contract is in another state than planned: the cash flow of the days between is that of "
    "the plan; --cash sets the actual one"
)
