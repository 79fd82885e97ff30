"""Runs with a simulator of one's own: results, resume, certificate and report."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from tests.domains.own.small import CASE, PLACE, SIMULATOR, write

from snapo.cli.main import main
from snapo.domains.own import DOMAIN
from snapo.solver.limits import LimitFound
from snapo.solver.solution import Solution
from snapo.study import commands
from snapo.study.carry_out import write_report
from snapo.study.commands import CaseRequest

CODE = ("simulator", "Shop")


@pytest.fixture(scope="module")
def solved(tmp_path_factory) -> Path:
    """A whole run of the small case."""
    folder = write(tmp_path_factory.mktemp("own") / "case")
    assert main(["solve", str(folder), *PLACE]) == 0
    return folder / "run"


def part(run: Path, name: str) -> dict:
    return json.loads((run / "parts" / f"{name}.json").read_text())


def test_the_run_has_every_part(solved):
    record = json.loads((solved / "run.json").read_text())
    names = ["training", "distribution", "profile", "moves", "certificate"]
    assert {name: each["state"] for name, each in record["parts"].items()} == {
        name: "done" for name in names
    }
    assert (solved / "case" / "simulator.py").read_text() == SIMULATOR
    assert "simulator.py" in record["decides"]["files"]
    assert record["decides"]["options"]["simulator"] == "simulator:Shop"
    result = json.loads((solved / "result.json").read_text())
    assert (result["kind"], result["status"]) == ("own", "trained")


def test_the_value_is_that_of_the_paths(solved):
    """Without control variates the value is the mean of the objective's output."""
    result = json.loads((solved / "result.json").read_text())
    totals = Solution.load(solved).totals
    assert result["value"] == pytest.approx(totals["profit"].mean(), rel=1e-12)
    described = {each["name"]: each for each in part(solved, "distribution")["distribution"]}
    assert described["profit"]["mean"] == pytest.approx(result["value"], rel=1e-12)
    assert described["profit"]["quantiles"]["p50"] == np.median(totals["profit"])
    assert sum(described["sold"]["counts"]) == 1024
    worst = np.sort(totals["profit"])[: round(0.05 * 1024)].mean()
    assert described["profit"]["tail_mean"] == pytest.approx(worst, rel=1e-12)


def test_the_fans_close_the_books(solved):
    """What is bought less what is sold is what the stock gains: means, path by path linear."""
    series = {each["name"]: each for each in part(solved, "profile")["profile"]["series"]}
    assert [each["kind"] for each in series.values()] == ["state", "action", "outputs", "outputs"]
    stock, bought, sold = (np.array(series[n]["mean"]) for n in ("stock", "action", "sold"))
    assert len(stock) == 9 and stock[0] == 5
    assert np.diff(stock) == pytest.approx(bought - sold, abs=1e-9)
    assert series["stock"]["unit"] == "pieces"
    quantiles = np.array([series["sold"][name] for name in ("p01", "p25", "p50", "p75", "p99")])
    assert np.all(np.diff(quantiles, axis=0) >= 0)


def test_moves_are_the_sensitivities_along_them(solved):
    moves = {each["input"]: each for each in part(solved, "moves")["moves"]}
    table = Solution.load(solved).sensitivities
    assert table is not None
    price, demand = moves["price"], moves["demand"]
    along = table.along("price", np.full((), 0.1))
    assert price["effect"] == pytest.approx(0.1 * float(table["price"].value), rel=1e-12)
    assert (price["low"], price["high"]) == (along.low, along.high)
    assert (price["amount"], price["unit"]) == (pytest.approx(10), "cents")
    one_percent = 0.01 * float(table.held["demand"].value @ table.inputs["demand"].value)
    assert demand["held"] == pytest.approx(one_percent, rel=1e-12)
    assert demand["bump"] == table.verdicts["demand"].bump[0]
    assert [row["source"] for row in (price, demand)] == [
        table.source(n) for n in ("price", "demand")
    ]
    assert (demand["share"], demand["amount"]) == (0.01, None)


def test_the_certificate_holds(solved):
    found = part(solved, "certificate")["certificate"]
    assert {each["family"] for each in found["bump_check"]} == {"stock", "price", "cost", "demand"}
    assert all(each["passed"] for each in found["bump_check"])
    assert [(each["limit"], each["passed"]) for each in found["feasibility"]] == [("stock", True)]


def test_the_report_tells_all_of_it(solved):
    page = (solved / "report.html").read_text()
    for anchor in ("value", "sensitivities", "distribution", "profile", "history", "certificate",
                   "making"):  # fmt: skip
        assert f'<section id="{anchor}"' in page
    for words in ("Shop", "8 days", "+10", "cents", "at the start", "simulator:Shop", "EUR"):
        assert words in page, words
    # Nobody gave this simulator a relaxation.
    assert 'class="missing"' not in page and "no upper bound" in page
    assert page.count("<svg") == 1 + 2 + 4 + 1  # tornado, histograms, fans, training


@pytest.mark.prove
def test_a_warning_of_check_is_a_note_of_the_run_with_its_remedy(tmp_path, capsys, sketched):
    """An input that nothing uses: what `check` prints stands in the result and in the report."""
    unused = CASE.replace("[units]", "idle = { value = 1 }\n[units]").replace("= 30", "= 2")
    folder = write(tmp_path / "case", case=unused)
    assert main(["check", str(folder), *PLACE]) == 0
    place, what, remedy = capsys.readouterr().out.split("warning: ")[1].split("\n")[:3]
    assert "idle" in place and "changes no output" in what
    assert main(["solve", str(folder), *PLACE]) == 0
    told = capsys.readouterr().err
    note = f"{place}: {what.strip()} {remedy.strip()}"
    assert f"note: {note}" in told
    assert note in json.loads((folder / "run" / "result.json").read_text())["notes"]
    assert (folder / "run" / "report.html").read_text().count("changes no output") == 1


def stopped(folder: Path, line: str) -> None:
    """Solves, and is interrupted at the first progress line that begins so."""
    seen = []

    def tell(text: str) -> None:
        if text.startswith(line) and not seen:
            seen.append(text)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        commands.solve(CaseRequest(folder, (), CODE), tell)
    assert seen


@pytest.mark.prove
@pytest.mark.parametrize("line", ["step    20", "profile"])
def test_an_interrupted_run_goes_on_to_the_same_bits(solved, tmp_path, line, sketched):
    folder = write(tmp_path / "case")
    stopped(folder, line)
    assert main(["solve", str(folder), *PLACE, "--resume"]) == 0
    for name in ("distribution", "profile", "moves"):
        assert part(folder / "run", name) == part(solved, name)
    ours, theirs = (
        json.loads((run / "result.json").read_text()) for run in (folder / "run", solved)
    )
    for key in ("value", "standard_error", "smoothing_gap", "policy_gradient_norm"):
        assert ours[key] == theirs[key], key
    same = "sensitivities.csv"
    assert (folder / "run" / same).read_bytes() == (solved / same).read_bytes()


def test_other_code_is_not_resumed(solved, tmp_path, capsys):
    folder = Path(shutil.copytree(solved.parent, tmp_path / "case"))
    (folder / "simulator.py").write_text(SIMULATOR + "# changed\n")
    assert main(["solve", str(folder), *PLACE, "--resume"]) == 2
    assert "another simulator.py" in capsys.readouterr().err


@pytest.mark.prove
def test_compare_pairs_runs_on_the_same_scenarios(solved, tmp_path, capsys, sketched):
    """With the steps of training unchanged and one price moved, most of the noise cancels."""
    folder = solved.parent
    dearer, seeded = tmp_path / "dearer", tmp_path / "seeded"
    assert (
        main(
            ["solve", str(folder), *PLACE, "--set", "inputs.price.value=3.3", "--out", str(dearer)]
        )
        == 0
    )
    assert main(["solve", str(folder), *PLACE, "--seed", "1", "--out", str(seeded)]) == 0
    capsys.readouterr()
    assert main(["compare", str(solved), str(dearer), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["paired"]
    totals = [Solution.load(run).totals["profit"] for run in (solved, dearer)]
    pairs = (totals[1] - totals[0]).reshape(-1, 2).mean(1)  # antithetic paths stay together
    assert found["difference"] == pytest.approx(pairs.mean(), rel=1e-9)
    assert found["standard_error"] == pytest.approx(pairs.std(ddof=1) / np.sqrt(512), rel=1e-9)
    assert [each["name"] for each in found["settings"]] == ["inputs.price.value"]
    assert {each["input"] for each in found["sensitivities"]} <= {
        "stock",
        "price",
        "cost",
        "demand",
    }
    tables = [Solution.load(run).sensitivities for run in (solved, dearer)]
    for each in found["sensitivities"]:
        reported = [dict(zip(t.inputs[each["input"]].names(), t.of(each["input"]).numbers()))
                    [each["label"]] for t in tables]  # fmt: skip
        assert [each["first"], each["second"]] == [number.value for number in reported]
        assert each["policy"] == pytest.approx(sum(number.policy for number in reported))
        assert each["sources"] == [t.source(each["input"]) for t in tables]
    assert main(["compare", str(solved), str(seeded)]) == 0
    printed = capsys.readouterr().out
    assert "independent: the runs have different scenarios" in printed
    assert "training.seed" in printed


WRONG = {
    "branch": ("left = there - sold", "left = there - sold if there > sold else 0.0",
               ["step, ", "to decide something here"]),
    "name": ("sold = smooth.minimum(there", "sold = smooth.minimum(their", ["NameError", "their"]),
    "nan": ("0.1 * left", "0.1 * jnp.log(left - 1e6)", ["output profit is non-finite"]),
    "shape": ("jnp.stack([state", "jnp.sum([state", ["observe"]),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_a_mistake_in_the_simulator_is_a_finding_with_its_line(name, tmp_path, capsys):
    before, after, clauses = WRONG[name]
    assert before in SIMULATOR
    folder = write(tmp_path / "case", SIMULATOR.replace(before, after))
    assert main(["solve", str(folder), *PLACE]) == 2
    message = capsys.readouterr().err
    assert "Traceback" not in message
    assert "simulator.py:" in message
    for clause in clauses:
        assert clause in message, message
    assert not (folder / "run" / "run.json").exists()


@pytest.mark.prove
def test_an_output_that_is_not_there(tmp_path, capsys):
    folder = write(tmp_path / "case")
    assert main(["check", str(folder), *PLACE, "--set", 'objective.output="profits"']) == 2
    assert "the outputs of the simulator are profit, sold" in capsys.readouterr().err
    assert main(["check", str(folder), *PLACE, "--set", 'units.stocks="x"']) == 2
    assert "the nearest known key is stock" in capsys.readouterr().err


def test_the_report_tells_limits_where_there_are_some(solved, tmp_path):
    assert '<section id="limits"' not in (solved / "report.html").read_text()
    run = Path(shutil.copytree(solved, tmp_path / "run"))
    result = json.loads((run / "result.json").read_text())
    bound = LimitFound("mean of sold at most 90", 90.0, 90.25, 0.3, 89.65, 90.85, 1.503, 0.021, 1.5,
                       "met nearly")  # fmt: skip
    room = LimitFound("mean of left at least 3", 3.0, 8.0, 0.1, 7.8, 8.2, 0.0, 0.0, 0.0, "met")
    missed = bound._replace(name="mean of lost at most 1", met="not met")
    result["limits"] = [each._asdict() for each in (bound, room, missed)]
    (run / "result.json").write_text(json.dumps(result))
    record = json.loads((run / "run.json").read_text())
    record.pop("result", None)  # the hash of the file as it was
    (run / "run.json").write_text(json.dumps(record))
    section = write_report(DOMAIN, run).read_text().split('<section id="limits"')[1]
    section = re.sub(r"<[^>]+>", " ", section.split("</section>")[0]).replace("\xa0", " ")
    for words in ("mean of sold at most 90", "met nearly", "90.25", "89.65 to 90.85", "1.503",
                  "± 0.041", "not met", "EUR"):  # fmt: skip
        assert words in section, words
    rows = {name: section.split(name)[1][:120] for name in (bound.name, room.name)}
    assert "–" in rows[room.name] and "–" not in rows[bound.name]


@pytest.mark.prove
def test_a_limit_of_an_output_that_is_not_there_is_found_by_check(tmp_path, capsys):
    limits = 'horizon, noise_size = 8, 1\n    constraints = (snapo.AtMost("solds", 1.0),)'
    code = SIMULATOR.replace("horizon, noise_size = 8, 1", limits)
    assert main(["check", str(write(tmp_path / "case", code)), *PLACE]) == 2
    message = capsys.readouterr().err
    assert "simulator:Shop" in message and "constraints[0]" in message and "solds" in message
    assert "the outputs of the simulator are profit, sold" in message


def test_references_are_refused(tmp_path, capsys):
    folder = write(tmp_path / "case")
    assert main(["solve", str(folder), *PLACE, "--reference"]) == 2
    assert "a user-defined simulator has no exact values" in capsys.readouterr().err
