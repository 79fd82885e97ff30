""" "converged" has to be earned: no word of a training that was cut short may promise more."""

import pytest

from snapo.solver.verdict.convergence import CONVERGED

from .cut import PROBLEMS, SHARES, below, cut


@pytest.mark.study
@pytest.mark.parametrize("name", PROBLEMS)
def test_no_training_that_was_cut_short_and_is_below_the_whole_one_has_converged(name):
    """More than 1 % below, and more than two standard errors: with a twentieth to all of the steps
    that the problem has by default."""
    problem = PROBLEMS[name]()
    paths = 1024 if name == "battery" else 8192
    found = {share: cut(problem, share, paths) for share in SHARES}
    whole, wrong = found[1.0], []
    print(f"\n{name}")
    for share, each in found.items():
        short, error = below(whole, each)
        percent = 100 / abs(whole.value)
        print(
            f"{share:>5.0%} {len(each.history):>5} steps {each.value:>12.6g} "
            f"{percent * short:>8.2f} % ± {percent * error:.2f} below  {each.convergence}"
        )
        far = short > 0.01 * abs(whole.value) and short > 2 * error
        if far and each.convergence == CONVERGED:
            wrong.append(share)
    assert not wrong


@pytest.mark.prove
@pytest.mark.parametrize("steps", [10, pytest.param(60, marks=pytest.mark.prove)])
def test_the_reservoir_of_the_readme_has_not_converged_after_a_few_steps(steps):
    """13,928 and 15,613 for 16,043; both were "converged"."""
    solution = cut(PROBLEMS["reservoir"](), steps / 1846, 2048)
    assert len(solution.history) == steps
    assert solution.convergence in ("still improving", "too short to tell")
    assert any("steps" in note for note in solution.notes)
