"""A case of every domain, small enough to be solved in seconds: its template with less of it."""

from pathlib import Path

from snapo.testing.miniature import Miniature

LITTLE = ("training.paths=32", "training.validation_paths=64", "evaluation.sensitivity_paths=64")


def thirty_days() -> dict[str, str]:
    """A month of a small store with one price factor."""
    folder = Path(__file__).parent / "domains" / "gas_storage" / "cases" / "quick"
    return {each.name: each.read_text(encoding="utf-8") for each in folder.iterdir()}


def reactor() -> dict[str, str]:
    """A batch reactor alone, with measurements to fit."""
    from tests.domains.pharma.pharma_cases import CASE, data

    return {"case.toml": CASE, "batch.csv": data()}


def closed_loop() -> dict[str, str]:
    """A batch reactor with a policy for its temperature, and a controller beside it."""
    from tests.domains.pharma.pharma_cases import CASE, RULED_LOOP, data, small

    return {"case.toml": small(CASE + RULED_LOOP), "batch.csv": data()}


MINIATURES = {
    each.kind: each
    for each in (
        Miniature(
            "gas-storage",
            assignments=("training.steps=4", "evaluation.paths=256", *LITTLE),
            texts=thirty_days,
        ),
        Miniature(
            "swing",
            assignments=(
                "contract.end=2026-10-11",
                "contract.annual.min=3",
                "contract.annual.max=5",
                "training.steps=4",
                "evaluation.paths=256",
                *LITTLE,
            ),
        ),
        Miniature(
            "battery",
            assignments=(
                "contract.end=2026-05-04T12:00:00",
                "contract.energy=2",
                "training.steps=4",
                "evaluation.judge_paths=0",
                "evaluation.paths=256",
                *LITTLE,
            ),
        ),
        Miniature(
            "park-and-loan",
            assignments=(
                "contract.end=2026-07-13",
                "contract.max_park=200",
                "contract.max_loan=100",
                "training.steps=4",
                "evaluation.judge_paths=0",
                "evaluation.paths=256",
                *LITTLE,
            ),
        ),
        Miniature(
            "stores",
            assignments=(
                "market.valuation_date=2027-01-22",
                "contract.inventory=[2000.0, 3000.0]",
                "training.steps=4",
                "evaluation.judge_paths=0",
                "evaluation.paths=256",
                *LITTLE,
            ),
        ),
        Miniature(
            "plant",
            assignments=(
                "contract.end=2026-01-05T12:00:00",
                "contract.min_up=1",
                "contract.min_down=1",
                "contract.starts=[]",
                "training.steps=4",
                "evaluation.judge_paths=0",
                "evaluation.paths=256",
                *LITTLE,
            ),
        ),
        Miniature(
            "pension",
            "small",
            (
                "fund.years=2",
                "training.steps=4",
                "evaluation.paths=256",
                "frontier.points=2",
                "frontier.steps=2",
                *LITTLE,
            ),
        ),
        Miniature(
            "inventory",
            assignments=(
                "item.lead_time=1",
                "horizon.periods=6",
                "horizon.warm_up=2",
                "report.lead_time=false",
                "training.steps=4",
                "evaluation.paths=256",
                *LITTLE,
            ),
        ),
        Miniature("pharma", assignments=("evaluation.paths=128",), texts=reactor),
        Miniature(
            "own",
            None,
            ("training.steps=4", "evaluation.paths=256", *LITTLE),
            ("simulator", "Reservoir"),
        ),
        Miniature(
            "control",
            "double-integrator",
            ("plant.horizon=6", "training.steps=4", "evaluation.paths=256", *LITTLE),
        ),
    )
}
# Other cases whose runs are read by several test files.
FURTHER = {
    "closed-loop": Miniature("pharma", assignments=("training.seed=3",), texts=closed_loop),
}
