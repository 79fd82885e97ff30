"""The change of value between two runs of a contract, in parts: `snapo explain`."""

NOT_AS_PLANNED = (
    "the contract is in another state than planned: the cash flow between the two dates is that "
    "of the plan; --cash sets the actual one"
)
