"""Every public function takes a problem, or a simulator with all that belongs beside it."""

import json
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.solver.certificate import certify_derivatives
from snapo.solver.sensitivity import held_of_several


class Till(snapo.Simulator):
    """Two days, an amount bought on each at a price that is drawn."""

    horizon: object = 2
    noise_size: object = 1
    action: snapo.Box = snapo.Box(0.0, 1.0)

    def prepare(self, inputs):
        return snapo.Schedule(inputs, jnp.zeros(2))

    def initial(self, constants, noise):
        return jnp.zeros(())

    def observe(self, constants, now, state):
        return state[None]

    def step(self, constants, now, state, action, noise, smooth):
        cash = (constants["price"] + noise[0]) * action[0]
        return state + cash, {self.output: cash}

    @property
    def output(self):
        return "cash"


class Bill(Till):
    name: str = "total_cost"

    @property
    def output(self):
        return self.name


INPUTS = {"price": snapo.Input(2.0)}
HALF = snapo.Constant(np.full(1, 0.5))
SOURCES = snapo.Sources.of(None, 3)
PROBLEM = snapo.Problem(Till(), INPUTS, snapo.Mean("cash"), SOURCES)
FEW = {
    "training": snapo.Training(steps=1, paths=64, validation_paths=64),
    "evaluation": snapo.Evaluation(paths=64, sensitivity_paths=0),
}
UP = [{"price": np.ones(())}]
VERBS = {
    "evaluate": lambda *of, **more: snapo.evaluate(*of, HALF, paths=64, **more).value,
    "simulate": lambda *of, **more: snapo.simulate(*of, HALF, paths=64, **more).totals["cash"].mean(),
    "sensitivities": lambda *of, **more: snapo.sensitivities(*of, HALF, paths=64, **more)
    .held["price"].value,
    "value_and_gradient": lambda *of, **more: snapo.value_and_gradient(
        *of, HALF, paths=64, **more
    )[0],
    "bump_check": lambda *of, **more: snapo.bump_check(*of, HALF, paths=64, **more)[0].adjoint,
    "feasibility": lambda *of, **more: len(snapo.feasibility(*of, policy=HALF, **more)),
    "certify_derivatives": lambda *of, **more: certify_derivatives(*of, HALF, paths=64, **more)[0].central,
    "held_of_several": lambda *of, **more: held_of_several(
        *of, HALF, [snapo.Mean("cash")], paths=64, **more
    )[0]["price"].value,
    "second_order": lambda *of, **more: snapo.second_order(
        *of, HALF, paths=64, directions=UP, **more
    )[0]["price"],
    "solve": lambda *of, **more: snapo.solve(*of, HALF, **FEW, **more).value,
    "solve_seeds": lambda *of, **more: snapo.solve_seeds(*of, HALF, seeds=[3], **FEW, **more)
    .values[3],
    "check": lambda *of, **more: len(snapo.check(*of, paths=4, **more)),
}  # fmt: skip


@pytest.mark.parametrize("name", VERBS)
def test_a_problem_and_a_simulator_give_the_same(name):
    whole = VERBS[name](PROBLEM)
    parts = VERBS[name](Till(), INPUTS, objective="cash", scenarios=SOURCES)
    by_default = VERBS[name](Till(), INPUTS, scenarios=SOURCES)  # the only output there is
    assert float(whole) == float(parts) == float(by_default)


@pytest.mark.parametrize("name", sorted(set(VERBS) - {"check"}))
def test_what_stands_beside_a_problem_is_refused(name):
    with pytest.raises(ValueError, match=f"^{name}: a Problem has its own inputs, objective"):
        VERBS[name](PROBLEM, scenarios=SOURCES)
    with pytest.raises(ValueError, match=f"^{name}: a dict is neither a simulator nor a Problem"):
        VERBS[name]({}, INPUTS)
    with pytest.raises(
        ValueError, match=rf"^{name}: Till is a class; pass an object of it, Till\(\)"
    ):
        VERBS[name](Till, INPUTS)


def test_bounds_and_imitations_take_either():
    for of, more in (((PROBLEM,), {}), ((Till(), INPUTS), {"scenarios": SOURCES})):
        begun = snapo.imitate(*of, HALF, HALF, training=FEW["training"], **more)
        assert begun.distance == pytest.approx(0.0, abs=1e-6)
        with pytest.raises(ValueError, match="its simulator has no method `relaxation`"):
            snapo.bound(*of, HALF, **more)


@pytest.mark.parametrize(
    "sizes, said",
    [
        ({"horizon": 5.0}, "horizon is 5.0; it must be a whole number of at least 1"),
        ({"horizon": "5"}, "horizon is '5'; it must be a whole number of at least 1"),
        ({"horizon": -1}, "horizon is -1; it must be"),
        ({"horizon": True}, "horizon is True; it must be"),
        ({"noise_size": 1.5}, "noise_size is 1.5; it must be a whole number of at least 0"),
    ],
)
def test_sizes_that_are_none_are_named(sizes, said):
    wrong = Till(**sizes)
    for call in (
        lambda: snapo.solve(wrong, INPUTS),
        lambda: snapo.solve(replace(PROBLEM, simulator=wrong)),
        lambda: snapo.evaluate(wrong, INPUTS, HALF),
        lambda: snapo.simulate(replace(PROBLEM, simulator=wrong), HALF),
    ):
        with pytest.raises(ValueError) as error:
            call()
        assert said in str(error.value)
    (name,) = sizes
    assert any(each.where == name for each in snapo.check(wrong, INPUTS).errors)


def test_other_wrong_arguments_are_named():
    for call, said in (
        (lambda: snapo.evaluate(PROBLEM, None), "evaluate: policy is None; it must be a policy"),
        (lambda: snapo.simulate(PROBLEM, 3), "simulate: policy is 3; it must be a policy"),
        (
            lambda: snapo.evaluate(Till(), INPUTS, HALF, objective=3),
            "evaluate: objective is 3; it must be an objective, or the name of an output",
        ),
        (
            lambda: snapo.solve(Till(), INPUTS, scenarios=7),
            "solve: scenarios is 7; it must be scenarios",
        ),
        (
            lambda: snapo.solve(Till(), INPUTS, constraints=7),
            "solve: constraints is 7; it must be a list",
        ),
        (lambda: snapo.AtMost(3, 1.0), "AtMost: of is 3; it must be the name of an output"),
        (lambda: snapo.AtMost("x", "1"), "AtMost: level is '1'; it must be a finite number"),
        (lambda: snapo.AtMost("x", True), "AtMost: level is True; it must be a finite number"),
    ):
        with pytest.raises(ValueError) as error:
            call()
        assert said in str(error.value)


@pytest.mark.parametrize(
    "name", ["cost", "costs", "total_cost", "penaltyPaid", "Loss", "unserved shortfall"]
)
def test_a_cost_alone_is_not_made_large_in_silence(name):
    with pytest.raises(ValueError) as error:
        snapo.solve(Bill(name=name), INPUTS)
    for line in (f'objective=-snapo.Mean("{name}")', f'objective="{name}"'):
        assert line in str(error.value)


def test_the_printed_solution_says_what_was_made_large(tmp_path):
    found = snapo.solve(Till(), INPUTS, HALF, objective=-snapo.CVaR("cash", 0.9), **FEW)
    words = "maximised: minus the mean of the largest 10 % of cash"
    assert str(found).splitlines()[1] == words and words in found._repr_html_()
    found.save(tmp_path)
    assert snapo.Solution.load(tmp_path).lines()[1] == words
    assert json.loads((tmp_path / "result.json").read_text())["maximised"] == str(
        found.problem.objective
    )


def test_other_names_are_made_large():
    """Part of a word is no word."""
    for name in ("costume_sales", "profit", "glossy"):
        found = snapo.evaluate(Bill(name=name), INPUTS, HALF, paths=64)
        assert found.value == pytest.approx(2.0, abs=1.0)


def test_check_takes_a_problem_and_looks_at_its_outputs():
    assert not snapo.check(PROBLEM, paths=4).errors
    wrong = snapo.check(replace(PROBLEM, objective=snapo.Mean("money")), paths=4)
    assert "There is no output 'money'" in str(wrong)
