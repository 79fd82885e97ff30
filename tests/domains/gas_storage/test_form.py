"""A second contract of the same form is the same program: nothing is traced or compiled for it."""

import datetime
import shutil

import jax
import numpy as np
import pytest
from tests.compilations import compilations
from tests.domains.gas_storage.storage_cases import CASES, read
from tests.domains.same_form import PAIRS, same_programs

from snapo.domains.gas_storage.contract.simulator import StorageSimulator
from snapo.domains.gas_storage.setup import bare_problem, fitted_value, make_setup
from snapo.engine.native.call import COMPILED, _runners

FACTORS = {"mean_reversion": None, "volatility": None}
QUICK = {
    "training": {"steps": 2, "paths": 64, "validation_paths": 64},
    "evaluation": {"paths": 128, "sensitivity_paths": 64, "judge_paths": 0, "search_paths": 0},
}


KINDS = 9


def models(draw: np.random.Generator) -> list[dict]:
    """A price model of every kind, with numbers that are drawn."""
    reversion, volatility = (float(x) for x in draw.uniform((5, 0.3), (25, 0.9)))
    one = {"mean_reversion": reversion, "volatility": volatility}
    two = [one, {"mean_reversion": float(draw.choice([1.0, 30.0])), "volatility": 0.3}]
    correlation = float(draw.uniform(-0.5, 0.5))
    paths = {"training_paths": "paths.npy", "evaluation_paths": "others.npy"}
    return [
        {"kind": "one-factor", **one},
        {
            "kind": "multi-factor",
            **FACTORS,
            "factors": two,
            "correlation": [[1.0, correlation], [correlation, 1.0]],
        },
        {
            "kind": "three-factor-seasonal",
            **FACTORS,
            "spot_mean_reversion": reversion,
            "spot_volatility": volatility,
            "long_term_volatility": 0.2,
            "seasonal_volatility": float(draw.uniform(0, 0.3)),
        },
        {
            "kind": "one-factor-jumps",
            **one,
            "jump_intensity": float(draw.uniform(5, 40)),
            "jump_size": 0.3,
            "jump_mean_reversion": 150.0,
        },
        {"kind": "regimes", **one, "tightens": 0.05, "eases": 0.2, "premium": 0.4},
        {"kind": "supplied", **FACTORS, **paths, "rescale_to_curve": bool(draw.integers(2))},
        {
            "kind": "one-factor-poisson-jumps",
            **one,
            "jump_intensity": float(draw.uniform(5, 8)),
            "jump_size": 0.3,
            "jump_mean_reversion": 150.0,
        },
        {"kind": "one-factor-normal", **one, "volatility": 10 * volatility},
        {"kind": "one-factor-shifted", **one, "shift": float(draw.uniform(1, 50))},
    ]


def drawn(seed: int, folder):
    """A problem whose every number is drawn, and few of its rules; the kinds of prices in turn."""
    draw = np.random.default_rng(seed)
    kind = seed % KINDS
    model = models(draw)[kind]
    gap = int(draw.choice([0, 0, 1, 5, 6]))
    start = datetime.date(2025, 1, 1) + datetime.timedelta(int(draw.choice([0, 0, 31])))
    end = start + datetime.timedelta(30)
    dates = [start + datetime.timedelta(days) for days in range(-1, 32)]
    rows = [f"{day},{draw.uniform(20, 40):.3f}" for day in dates]
    (folder / "curve.csv").write_text("\n".join(["date,price", *rows]))
    rates = [
        f"{day},{draw.uniform(0, 0.05):.4f}" for day in (dates[0], dates[1 + kind % 6], dates[-1])
    ]
    (folder / "rates.csv").write_text("\n".join(["date,zero_rate", *rates]))
    fees = [f"{day},{draw.uniform(1, 5):.2f}" for day in (dates[3], dates[9])]
    (folder / "fees.csv").write_text("\n".join(["date,amount", *fees]))
    for name in ("paths", "others"):
        np.save(folder / f"{name}.npy", draw.uniform(20, 40, (8, 30)))
    end_inventory = draw.choice(["free", "level"])
    contract = {
        "start": start,
        "end": end,
        "inventory": float(draw.uniform(5, 15)),
        "max_inventory": float(draw.uniform(40, 60)),
        "max_injection": float(draw.uniform(4, 6)),
        "injection_cost": float(draw.uniform(0, 0.1)),
        "injection_fuel": float(draw.uniform(0, 0.02)),
        "inventory_loss": float(draw.uniform(0, 0.001)),
        "fixed_costs": "fees.csv",
        "end_inventory": "free" if end_inventory == "free" else float(draw.uniform(0, 5)),
    }
    if end_inventory == "free" and kind != 5:
        contract["end_value"] = float(draw.choice([0.0, 0.5, 0.9]))
    market = {
        "valuation_date": start - datetime.timedelta(gap),
        "interest_rate": "rates.csv",
        "settlement": {"days": int(draw.integers(0, 6))},
    }
    (folder / "case.toml").write_text((CASES / "quick" / "case.toml").read_text())
    return bare_problem(read(folder, contract=contract, market=market, model=model))


@pytest.mark.parametrize("kind", range(KINDS))
def test_a_simulator_has_arrays_alone(kind, tmp_path):
    problem = drawn(kind, tmp_path)
    leaves = jax.tree.leaves(problem.simulator)
    assert leaves and all(isinstance(leaf, np.ndarray) for leaf in leaves)
    assert isinstance(problem.simulator, StorageSimulator)
    assert not hasattr(problem.simulator, "case")


@PAIRS
def test_equal_forms_are_equal_programs(enough, tmp_path):
    problems = (drawn(seed, tmp_path) for seed in range(400))
    assert same_programs(problems, enough) >= enough


def other(case: dict, folder, days: int = 30) -> dict:
    """Another contract of the same form, a month later."""
    start = datetime.date(2025, 2, 1)
    shutil.copy(CASES / "quick" / "case.toml", folder)
    dates = [start + datetime.timedelta(days) for days in range(31)]
    rows = [f"{day},{30 + day.day % 7}" for day in dates]
    (folder / "curve.csv").write_text("\n".join(["date,price", *rows]))
    contract = {"start": start, "end": start + datetime.timedelta(days), "max_inventory": 45.0}
    return case | {
        "contract": contract | {"inventory": 12.0, "injection_cost": 0.03},
        "market": {
            "valuation_date": start,
            "interest_rate": 0.02,
            "settlement": {"days": 3},
        },
        "model": {"mean_reversion": 15.0, "volatility": 0.7},
    }


@pytest.mark.prove
def test_a_second_contract_compiles_no_kernel_and_has_its_own_bits(tmp_path):
    """The programs of `prepare` and of the optimiser's schedule depend on the number of days."""

    def solved(folder, changes):
        case = read(folder, **changes)
        return make_setup(case, "native", fitted_value(bare_problem(case))).solve()

    first, others = solved("quick", QUICK), []
    for days in (30, 25):
        folder = tmp_path / str(days)
        folder.mkdir()
        changes = other(QUICK, folder, days)
        with compilations() as made:
            others.append((folder, changes, solved(folder, changes)))
        assert COMPILED not in made and (days != 30 or not made)
    jax.clear_caches()
    _runners.clear()
    for folder, changes, second in others:
        again = solved(folder, changes)
        assert second.value == again.value != first.value
        assert jax.tree.all(jax.tree.map(np.array_equal, second.policy, again.policy))
