"""The change of value between two runs of a gas store, in parts: `snapo explain`."""

TIME, DECISIONS, SPOT = "time", "decisions taken", "spot prices"
FIRST, SECOND = "curve", "curve, second order"
RATE, CONTRACT, POLICY, REST, CASH = "interest rate", "contract", "policy", "rest", "cash"
NOTES = {
    TIME: "the valuation date moves; the curve, the model and the rates stay the same",
    DECISIONS: "inventory and cash flow, compared with the plan of the first run",
    SPOT: "spot prices of the actual flows compared with the forward prices of the first run",
    FIRST: "delta times move",
    SECOND: "half of the change in delta times the move",
    RATE: "discounting",
    CONTRACT: "other terms of the contract",
    POLICY: "the policy of the second run on the same paths",
    REST: "third order in the curve, error of the policy, and different paths",
    CASH: "minus the cash flow between the two valuation dates",
}
