"""A case of every domain, small enough to be solved in seconds: its template with less of it."""

from snapo.testing.miniature import Miniature

LITTLE = ("training.paths=32", "training.validation_paths=64", "evaluation.sensitivity_paths=64")

MINIATURES = {
    each.kind: each
    for each in (
        Miniature(
            "gas-storage",
            None,
            ("contract.end=2021-05-25", "training.steps=4", "evaluation.paths=256", *LITTLE),
        ),
        Miniature("pension"),
        Miniature("pharma"),
        Miniature(
            "own",
            None,
            ("training.steps=4", "evaluation.paths=256", *LITTLE),
            ("simulator", "Reservoir"),
        ),
    )
}
