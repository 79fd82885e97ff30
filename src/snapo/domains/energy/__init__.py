"""Energy contracts: one core values and operates all of them. Importing this module loads little
else."""

from snapo.study.kind import Kind

EXPLAINER = "explain.parts:explained_change"
SWING = Kind(
    "swing",
    "a swing contract: volumes at a strike within annual limits",
    __name__,
    {"take-or-pay": "template_swing"},
    summary="summary:lines",
    tables="read.case:swing_formats",
    explainer=EXPLAINER,
)
BATTERY = Kind(
    "battery",
    "a battery: energy by the hour, with wear and a limit on cycles",
    __name__,
    {"week": "template_battery"},
    summary="summary:lines",
    tables="read.case:battery_formats",
    explainer=EXPLAINER,
)
PARK_AND_LOAN = Kind(
    "park-and-loan",
    "a park and loan service at a hub: gas delivered and taken back, or taken and returned",
    __name__,
    {"winter": "template_park_and_loan"},
    summary="summary:lines",
    tables="read.case:park_and_loan_formats",
    explainer=EXPLAINER,
)
PLANT = Kind(
    "plant",
    "a power plant: power from gas by the hour, with hot and cold starts and minimum times",
    __name__,
    {"week": "template_plant"},
    summary="summary:lines",
    tables="read.case:plant_formats",
    explainer=EXPLAINER,
)
STORES = Kind(
    "stores",
    "two gas stores behind one connection: a joint limit on their flows, transfers between them",
    __name__,
    {"fast-and-slow": "template_stores"},
    summary="summary:lines",
    tables="read.case:stores_formats",
    explainer=EXPLAINER,
)
