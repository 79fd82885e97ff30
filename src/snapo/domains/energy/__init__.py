"""Energy contracts: one core values and steers them all; light until there is work to do."""

from snapo.study.kind import Kind

SWING = Kind(
    "swing",
    "a swing contract: volumes at a strike within annual limits",
    __name__,
    {"take-or-pay": "template_swing"},
    tables="read.case:swing_formats",
)
BATTERY = Kind(
    "battery",
    "a battery: energy by the hour, with wear and a limit on cycles",
    __name__,
    {"week": "template_battery"},
    tables="read.case:battery_formats",
)
PARK_AND_LOAN = Kind(
    "park-and-loan",
    "a park and loan at a pipeline or hub: gas delivered and taken back, or taken and returned",
    __name__,
    {"winter": "template_park_and_loan"},
    tables="read.case:park_and_loan_formats",
)
